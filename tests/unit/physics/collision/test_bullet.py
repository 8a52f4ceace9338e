"""What pybullet says about shapes that overlap."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.collision.bullet import BulletEngine
from uwserver.physics.collision.engine import Pose, engine_attitude
from uwserver.physics.geometry.rows import part
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Placed, Shape, Sphere

pytest.importorskip("pybullet")

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
    w, *rest = engine_attitude(placed)
    return Pose(np.array([x, y, z]), np.array([*rest, w]))


def added(engine: BulletEngine, placed: Placed) -> int:
    return engine.add(placed, part(placed))


@pytest.mark.parametrize("name", SUNK)
def test_the_way_out_of_a_floor_is_up(name: str) -> None:
    """Far from where the shapes were added, and twice, as an answer depends on the poses alone."""
    placed, height = SUNK[name]
    floor = Placed(Box((5.0, 5.0, 0.5)))
    engine = BulletEngine()
    a, b = added(engine, placed), added(engine, floor)
    for shift in (0.0, 70.0, 0.0):
        way = engine.way_out(a, at(placed, shift + 0.3, 0.2, -0.5 - height + 0.01), b, at(floor, shift, 0.0, 0.0))
        np.testing.assert_allclose(way, [0.0, 0.0, -1.0], rtol=0.0, atol=1e-3)
    engine.close()


@pytest.mark.parametrize("shape", [Sphere(0.2), Box((0.2, 0.2, 0.2))], ids=["sphere", "box"])
def test_what_was_removed_is_gone_and_the_others_stay(shape: Shape) -> None:
    engine, placed = BulletEngine(), Placed(shape)
    a, b, c = (added(engine, placed) for _ in range(3))
    engine.remove(b)
    way = engine.way_out(a, at(placed, 0.39, 0.0, 0.0), c, at(placed, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(way, [1.0, 0.0, 0.0], rtol=0.0, atol=1e-3)
    engine.close()
    engine.close()  # nothing more


def test_what_comes_and_goes_is_made_once() -> None:
    """Bullet keeps the memory of every shape that it ever had: it is used again, and answers as if new."""
    engine, fresh = BulletEngine(), BulletEngine()
    ball, block = Placed(Sphere(0.2)), Placed(Box((0.3, 0.2, 0.1)))
    ways = []
    for k in range(20):
        handles = [added(engine, ball), added(engine, block)]
        ways.append(
            engine.way_out(handles[0], at(ball, 0.1 * k + 0.45, 0.0, 0.0), handles[1], at(block, 0.1 * k, 0.0, 0.0))
        )
        for handle in handles[:: (-1) ** k]:
            engine.remove(handle)
    assert engine._bullet.getNumBodies(physicsClientId=engine._client) == 2
    new = fresh.way_out(added(fresh, ball), at(ball, 2.35, 0.0, 0.0), added(fresh, block), at(block, 1.9, 0.0, 0.0))
    assert ways[-1].tolist() == new.tolist()
    engine.close()
    fresh.close()


def test_the_engine_does_not_greet() -> None:
    """pybullet writes its date of birth to standard error."""
    done = subprocess.run(
        [sys.executable, "-c", "from uwserver.physics.collision.bullet import BulletEngine; BulletEngine().close()"],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert done.stderr == ""
