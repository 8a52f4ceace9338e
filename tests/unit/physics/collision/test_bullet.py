"""What pybullet says about shapes that overlap."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest
from engine_rig import SHAPES, SUNK, added, at, finds_the_way_out_of_a_floor, forgets_what_was_removed

from uwserver.physics.collision.bullet import BulletEngine
from uwserver.physics.geometry.shapes import Box, Placed, Sphere

pytest.importorskip("pybullet")


@pytest.mark.parametrize("name", SUNK)
def test_the_way_out_of_a_floor_is_up(name: str) -> None:
    finds_the_way_out_of_a_floor(BulletEngine(), name)


@pytest.mark.parametrize("shape", SHAPES)
def test_what_was_removed_is_gone_and_the_others_stay(shape: str) -> None:
    forgets_what_was_removed(BulletEngine(), SHAPES[shape])


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


def test_what_nobody_has_any_more_is_given_back() -> None:
    """Else each world that was loaded would keep 29 MB, and the thousandth could not be loaded."""
    gc.collect()
    clients = []
    for _ in range(5):
        engine = BulletEngine()
        clients.append(engine._client)
        del engine
        gc.collect()
    assert len(set(clients)) == 1
    closed = BulletEngine()
    closed.close()
    closed.close()
