"""The calibration of a camera, as a user would find it with a board in the water, in the formats of ROS and OpenCV.

A lens without a port, or behind a dome centred on its pupil, is reported as it is. Behind a flat port the rays do not meet in one point. Then a
lens is fitted as a calibration does: focal length and radial terms, by least squares, for points at one distance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import UnsetType

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.sensors.base import SensorTable
from uwserver.sensors.optical.camera.config import CameraTable
from uwserver.sensors.optical.camera.lens import Lens, outside

DISTANCE_M = 2.0
"""Distance of the board."""
_SAMPLES = 41


class Calibration(NamedTuple):
    """The result of a calibration.

    Attributes:
        lens: the model of the lens.
        error_px: root mean square of the residuals; 0 if the model is exact.
        baseline: baseline of the right camera of a pair, m; 0 for any other camera.
    """

    lens: Lens
    error_px: float = 0.0
    baseline: float = 0.0


def calibration(config: CameraTable, distance: float = DISTANCE_M) -> Calibration:
    """Return the calibration of a camera in the water, with a board at a distance (m)."""
    lens, window = config.optics(), config.window()
    u, v = (
        grid.ravel()
        for grid in np.meshgrid(np.linspace(0, lens.width - 1, _SAMPLES), np.linspace(0, lens.height - 1, _SAMPLES))
    )
    direction = lens.directions(u, v)
    bundle = outside(window, direction)
    seen = bundle.origin + distance * bundle.direction
    if float(np.abs(np.cross(seen, direction)).max()) < 1e-9:
        return Calibration(lens)
    return _fitted(lens, seen, u, v)


def calibrations(sensors: Mapping[str, SensorTable], distance: float = DISTANCE_M) -> dict[str, Calibration]:
    """Return the calibrations of all cameras among some sensors, by name. A pair also has ``<name>/right``."""
    found: dict[str, Calibration] = {}
    for name, config in sensors.items():
        if isinstance(config, CameraTable):
            found[name] = calibration(config, distance)
            if not isinstance(config.baseline_m, UnsetType):
                found[f"{name}/right"] = found[name]._replace(baseline=config.baseline_m)
    return found


def _fitted(lens: Lens, seen: FloatArray, u: FloatArray, v: FloatArray) -> Calibration:
    """Return the lens with the same principal point that fits best: it maps the points `seen` (n, 3) near to their pixels u and v."""
    across = np.hypot(seen[:, 1], seen[:, 2])
    fisheye = lens.model == "fisheye"
    bend = np.arctan2(across, seen[:, 0]) if fisheye else across / seen[:, 0]
    turned = np.divide(seen[:, 1:], across[:, None], out=np.zeros((len(seen), 2)), where=across[:, None] > 0.0)
    terms = 5 if fisheye else 4
    ratio = lens.fy / lens.fx
    powers = np.stack([bend ** (2 * k + 1) for k in range(terms)], axis=1)
    left = np.concatenate((powers * turned[:, :1], powers * turned[:, 1:]))
    right = np.concatenate((u - lens.cx, (v - lens.cy) / ratio))
    scale = np.abs(left).max(axis=0)
    found = np.linalg.lstsq(left / scale, right, rcond=None)[0] / scale
    fx, k = float(found[0]), (found[1:] / found[0]).tolist()
    coefficients = tuple(k) if fisheye else (k[0], k[1], 0.0, 0.0, k[2])
    off = left @ found - right
    model = lens._replace(
        fx=fx, fy=fx * ratio, model="fisheye" if fisheye else "brown_conrady", coefficients=coefficients
    )
    return Calibration(model, float(np.sqrt(2.0 * (off**2).mean())))


def as_ros(name: str, found: Calibration) -> str:
    """Return the file that camera_info_manager and image_pipeline read (YAML)."""
    lens, k = found.lens, matrix(found.lens)
    model = {"fisheye": "equidistant"}.get(lens.model, "plumb_bob")
    distortion = lens.coefficients or (0.0,) * 5
    projection = [*k[0:3], -lens.fx * found.baseline, *k[3:6], 0.0, *k[6:9], 0.0]
    return "\n".join((
        f"image_width: {lens.width}",
        f"image_height: {lens.height}",
        f"camera_name: {name}",
        *_ros_matrix("camera_matrix", 3, 3, k),
        f"distortion_model: {model}",
        *_ros_matrix("distortion_coefficients", 1, len(distortion), distortion),
        *_ros_matrix("rectification_matrix", 3, 3, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)),
        *_ros_matrix("projection_matrix", 3, 4, projection),
        "",
    ))  # fmt: skip


def as_opencv(found: Calibration) -> str:
    """Return the file that cv::FileStorage reads (YAML)."""
    lens = found.lens
    distortion = lens.coefficients or (0.0,) * 5
    lines = ["%YAML:1.0", "---", f"image_width: {lens.width}", f"image_height: {lens.height}"]
    for name, rows, columns, data in (
        ("camera_matrix", 3, 3, matrix(lens)),
        ("distortion_coefficients", 1, len(distortion), distortion),
    ):
        lines += [
            f"{name}: !!opencv-matrix",
            f"   rows: {rows}",
            f"   cols: {columns}",
            "   dt: d",
            f"   data: [{_numbers(data)}]",
        ]
    lines += [f"avg_reprojection_error: {found.error_px:.6g}", ""]
    return "\n".join(lines)


def matrix(lens: Lens) -> tuple[float, ...]:
    """Return the camera matrix K, row after row."""
    return (lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0)


def _ros_matrix(name: str, rows: int, columns: int, data: Sequence[float]) -> tuple[str, ...]:
    return f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{_numbers(data)}]"


def _numbers(data: Sequence[float]) -> str:
    return ", ".join(f"{float(x):.10g}" for x in data)
