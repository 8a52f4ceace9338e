"""Loads all compiled code of cameras at once, before a world runs."""

from __future__ import annotations

from functools import cache

import numpy as np

from uwserver.environment.light import WATER_TYPES, Daylight
from uwserver.frames import IDENTITY
from uwserver.physics.geometry.shapes import Box, HalfSpace, Placed, Solid
from uwserver.sensors.optical.camera import electronics, faces, formation, lamps, rays, snow, surface
from uwserver.sensors.optical.camera.faces import Paint
from uwserver.sensors.optical.camera.lamps import LampAt
from uwserver.sensors.optical.camera.lens import lens_of
from uwserver.sensors.optical.camera.picture import Optics
from uwserver.sensors.optical.camera.view import Pose, View
from uwserver.sensors.optical.camera.visible import Models, VisibleScene, VisibleThing

KERNELS = (
    faces.average_normals, rays.turn, rays.meet_floor, rays.select, rays.meet, rays.end_inside, rays.darken, rays.depths, rays.owners,
    lamps.fill_veil, lamps.light_rays, surface.fill_tile, formation.form, snow.add_flakes, electronics.expose, electronics.expose_mono,
    electronics.develop,
)  # fmt: skip
"""The kernels that Python calls."""


@cache
def load() -> None:
    """Run each kernel once, so that it is compiled or loaded from the cache and no picture waits for it.

    Raises:
        RuntimeError: they do not show a box in front of the camera.
    """
    grey = Paint([(0.5, 0.5, 0.5)])
    box = Solid("box", (Placed(Box((0.2, 0.2, 0.2)), (1.0, 0.0, 3.0)),))
    floor = Solid("floor", (Placed(HalfSpace(), (0.0, 0.0, 4.0)),))
    carried = Solid("carried", (Placed(Box((0.1, 0.1, 0.1))),))
    things = (
        VisibleThing("box", box, grey),
        VisibleThing("floor", floor, grey),
        VisibleThing("carried", carried, grey, row=0),
    )
    state = np.zeros((1, 13))
    state[0, 2], state[0, 3] = 3.0, 1.0
    pose = Pose((0.0, 0.0, 3.0), IDENTITY)
    lamp = LampAt(0, (0.0, 0.0, -0.2), IDENTITY, 2.0, 1000.0)
    view = View(
        0.0, VisibleScene(things, Models()), state, pose, pose, 3.0, WATER_TYPES["II"], Daylight(0.0), (lamp,), own=0
    )
    optics = Optics(lens_of((16, 16), 1.0), None, 50.0)
    seen = optics.form(view)
    depth, (ids, _) = optics.depth_mm(view), optics.ids(view)
    n, per = 256, np.ones(3)
    counts, single, picture = np.empty((n, 3), np.uint16), np.empty((n, 1), np.uint16), np.empty((n, 3), np.uint8)
    electronics.expose(seen, per, 0.0, 1e4, 2.0, 1.0, np.uint64(7), electronics.normal_table(), counts)
    electronics.expose_mono(seen, per, 0.0, 1e4, 2.0, 1.0, np.uint64(7), electronics.normal_table(), single.reshape(-1))
    table = electronics.gamma_table()
    electronics.develop(counts, table, per, picture)
    electronics.develop(single, table, np.ones(1), np.empty((n, 1), np.uint8))
    if not (abs(int(depth[8, 8]) - 800) <= 1 and ids[8, 8] == 1 and picture[100].any()):
        raise RuntimeError("the kernels of cameras do not show a box in front of the camera: reinstall numpy and numba")
