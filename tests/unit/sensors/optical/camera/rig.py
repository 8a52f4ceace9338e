"""A little world for cameras: a floor, a wall, and what a test adds."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.environment.light import Daylight, WaterLight
from uwserver.frames import IDENTITY, Quat, Vec3
from uwserver.physics.geometry.shapes import Box, HalfSpace, Placed, Shape, Solid
from uwserver.sensors.optical.camera.faces import Paint
from uwserver.sensors.optical.camera.view import Pose, View
from uwserver.sensors.optical.camera.visible import Models, VisibleScene, VisibleThing

GREY = Paint([(0.5, 0.5, 0.5)])
CLEAR = WaterLight((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
DARK = Daylight(0.0)
NOON = Daylight(50_000.0, 1.5707, 0.0, 0.0)


def seen(name: str, shape: Shape, p: Vec3, row: int = -1, q: Quat = IDENTITY, paint: Paint = GREY) -> VisibleThing:
    return VisibleThing(name, Solid(name, (Placed(shape, p, q),)), paint, row=row)


def floor(depth: float) -> VisibleThing:
    return VisibleThing("floor", Solid("floor", (Placed(HalfSpace(), (0.0, 0.0, depth)),)), GREY)


def wall(x: float) -> VisibleThing:
    return seen("wall", Box((0.1, 50.0, 50.0)), (x + 0.1, 0.0, 0.0))


def view(*things: VisibleThing, p: Vec3 = (0.0, 0.0, 10.0), q: Quat = IDENTITY, bodies: Any = (), **rest: Any) -> View:
    state = np.zeros((max(len(bodies), 1), 13))
    state[:, 3] = 1.0
    for row, place in enumerate(bodies):
        state[row, : len(place)] = place
    pose = Pose(p, q)
    given: dict[str, Any] = {"water": CLEAR, "day": DARK, "depth": p[2]} | rest
    return View(0.0, VisibleScene(things, Models()), state, pose, given.pop("last", pose), **given)
