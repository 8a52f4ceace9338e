"""The pictures of the pages on cameras: a jacket's legs, a pipe and a crate on sand, by day in four waters and by lamps in three."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from uwserver.environment.light import WATER_TYPES, Daylight, WaterType
from uwserver.frames import Quat, Vec3, quat_from_rpy
from uwserver.physics.geometry.shapes import Box, Cylinder, Placed, Shape, Solid, Sphere, TriangleMesh
from uwserver.sensors import CameraConfig
from uwserver.sensors.optical.camera import electronics
from uwserver.sensors.optical.camera.faces import GROWTH, PLAIN, SEABED, Paint
from uwserver.sensors.optical.camera.lamps import LampAt
from uwserver.sensors.optical.camera.picture import Optics
from uwserver.sensors.optical.camera.view import Pose, View
from uwserver.sensors.optical.camera.visible import Models, VisibleScene, VisibleThing
from uwserver.units import rad

DOCS = Path(__file__).parents[1] / "docs/images"
SIZE = 400, 300
DAYS: tuple[WaterType, ...] = ("I", "II", "1C", "3C")
NIGHTS: tuple[WaterType, ...] = ("I", "II", "3C", "7C")


def main() -> None:
    """Write them."""
    camera = CameraConfig(rate_hz=10.0, width=SIZE[0], height=SIZE[1])
    optics, scene = Optics(camera.optics(), None, camera.snow_pm3), VisibleScene(things(), Models())
    day = [photograph(camera, optics, scene, water, (0.0, 0.0, 9.5), Daylight()) for water in DAYS]
    night = [photograph(camera, optics, scene, water, (1.6, 0.0, 10.6), Daylight(0.0), lamps()) for water in NIGHTS]
    shallow = photograph(camera, optics, scene, "II", (0.0, 0.0, 9.5), Daylight(), shift=-8.0, up=0.15)
    above = photograph(camera, optics, scene, "I", (0.0, 0.0, 9.5), Daylight(), up=0.9)
    DOCS.mkdir(parents=True, exist_ok=True)
    side_by_side([*day[:2], shallow, above]).save(DOCS / "camera_day.jpg", quality=84)
    side_by_side(night).save(DOCS / "camera_lamps.jpg", quality=84)
    small = side_by_side([day[1], night[1]])
    small.resize((small.width // 2, small.height // 2)).save(DOCS / "sensor_camera.png", optimize=True)


def photograph(
    camera: CameraConfig, optics: Optics, scene: VisibleScene, water: WaterType, p: Vec3, day: Daylight, lamps: tuple[LampAt, ...] = (),
    shift: float = 0.0, up: float = -0.2,
) -> Any:  # fmt: skip
    """A picture that is exposed as auto-exposure would have it; `shift` (m) lowers the surface onto the scene."""
    state = np.zeros((1, 13))
    state[0, :7] = (*p, 1.0, 0.0, 0.0, 0.0)
    pose = Pose(p, quat_from_rpy(0.0, up, 0.0))
    view = View(3.0, scene, state, pose, pose, p[2] + shift, WATER_TYPES[water], day, lamps, own=0)
    light = optics.form(view)
    chip = electronics.Chip(
        camera.pixel_um, camera.f_number, camera.quantum_efficiency, camera.full_well_e, camera.read_noise_e, camera.dark_current_eps,
        electronics.MOST_DN / camera.full_well_e,
    )  # fmt: skip
    brightest = float(np.percentile((light * chip.electrons(1.0)).max(axis=1), electronics.PERCENTILE))
    time = min(electronics.TARGET * chip.full_well / brightest, 0.09)
    gain = electronics.TARGET * chip.full_well / (brightest * time)
    counts, picture = np.empty((len(light), 3), np.uint16), np.empty((len(light), 3), np.uint8)
    electronics.expose(
        light, chip.electrons(time), chip.dark * time, chip.full_well, chip.read_noise, chip.gain * gain, np.uint64(1),
        electronics.normal_table(), counts,
    )  # fmt: skip
    electronics.develop(counts, electronics.gamma_table(), np.ones(3), picture)
    return picture.reshape(camera.height, camera.width, 3)


def side_by_side(pictures: list[Any]) -> Image.Image:
    """Two in a row."""
    rows = [np.concatenate(pictures[k : k + 2], axis=1) for k in range(0, len(pictures), 2)]
    return Image.fromarray(np.concatenate(rows, axis=0))


def lamps() -> tuple[LampAt, ...]:
    """Two of an ROV, to both sides of the lens."""
    down = quat_from_rpy(0.0, -0.17, 0.0)
    return tuple(LampAt(0, (0.0, y, 0.1), down, rad(135.0), 1500.0) for y in (-0.25, 0.25))


def things() -> list[VisibleThing]:
    """Sand with ripples at 12 m, and what stands and lies there."""
    n = 201
    x, y = np.meshgrid(np.linspace(-50.0, 50.0, n), np.linspace(-50.0, 50.0, n), indexing="ij")
    z = 12.0 + 0.4 * np.sin(0.2 * x) * np.cos(0.23 * y) + 0.03 * np.sin(3.0 * x)
    i = np.arange((n - 1) * n).reshape(n - 1, n)[:, :-1].ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    bed = TriangleMesh(np.stack([x, y, z], -1).reshape(-1, 3), faces)
    upright = quat_from_rpy(0.0, rad(90.0), 0.0)
    steel, concrete, yellow = (0.33, 0.36, 0.39), (0.42, 0.41, 0.38), (0.85, 0.62, 0.08)
    level: Quat = (1.0, 0.0, 0.0, 0.0)
    rest: list[tuple[Shape, Vec3, Quat, tuple[float, float, float], int]] = [
        (Cylinder(0.4, 8.0), (6.0, -2.0, 8.0), upright, steel, GROWTH),
        (Cylinder(0.4, 8.0), (9.0, 3.0, 8.0), upright, steel, GROWTH),
        (Cylinder(0.4, 8.0), (15.0, -4.0, 8.0), upright, steel, GROWTH),
        (Cylinder(0.25, 15.0), (5.0, 1.5, 11.9), quat_from_rpy(0.0, 0.0, 0.5), steel, GROWTH),
        (Box((0.5, 0.5, 0.5)), (4.0, -0.8, 11.6), level, concrete, GROWTH),
        (Sphere(0.3), (3.2, 0.6, 11.5), level, yellow, PLAIN),
    ]
    sand = VisibleThing("seabed", Solid("seabed", (Placed(bed),)), Paint([(0.55, 0.47, 0.31)], (SEABED,)))
    return [
        sand,
        *(
            VisibleThing(str(k), Solid(str(k), (Placed(s, p, q),)), Paint([c], (t,)))
            for k, (s, p, q, c, t) in enumerate(rest)
        ),
    ]


if __name__ == "__main__":
    main()
