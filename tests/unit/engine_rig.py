"""What every engine for contacts must say about shapes that overlap."""

from __future__ import annotations

import numpy as np

from uwserver.frames import quat_from_rpy
from uwserver.physics.collision.engine import Engine, Pose, engine_attitude
from uwserver.physics.geometry.rows import part
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Placed, Sphere

CORNERS = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.2, 0.2) for z in (-0.1, 0.1)])
ON_END = quat_from_rpy(0.0, np.pi / 2, 0.0)
SUNK = {  # shape, and height of its middle over its lowest point
    "box": (Placed(Box((0.3, 0.2, 0.1))), 0.1),
    "hull": (Placed(ConvexHull(CORNERS)), 0.1),
    "sphere": (Placed(Sphere(0.1)), 0.1),
    "cylinder on its side": (Placed(Cylinder(0.1, 0.3)), 0.1),
    "cylinder on its end": (Placed(Cylinder(0.1, 0.3), q=ON_END), 0.3),
    "capsule on its end": (Placed(Capsule(0.1, 0.3), q=ON_END), 0.4),
}


def at(placed: Placed, x: float, y: float, z: float) -> Pose:
    """A shape at a place, as it is turned."""
    w, *rest = engine_attitude(placed)
    return Pose(np.array([x, y, z]), np.array([*rest, w]))


def added(engine: Engine, placed: Placed) -> int:
    """The engine's number of a shape."""
    return engine.add(placed, part(placed))


def finds_the_way_out_of_a_floor(engine: Engine, name: str) -> None:
    """It is up: far from where the shapes were added, and twice, as an answer depends on the poses alone."""
    placed, height = SUNK[name]
    floor = Placed(Box((5.0, 5.0, 0.5)))
    a, b = added(engine, placed), added(engine, floor)
    for shift in (0.0, 70.0, 0.0):
        way = engine.way_out(a, at(placed, shift + 0.3, 0.2, -0.5 - height + 0.01), b, at(floor, shift, 0.0, 0.0))
        np.testing.assert_allclose(way, [0.0, 0.0, -1.0], rtol=0.0, atol=1e-3)
    engine.close()
    engine.close()  # nothing more
