"""What pybullet says about shapes that overlap."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest
from engine_rig import SUNK, finds_the_way_out_of_a_floor

from uwserver.physics.collision.bullet import BulletEngine

pytest.importorskip("pybullet")


@pytest.mark.parametrize("name", SUNK)
def test_the_way_out_of_a_floor_is_up(name: str) -> None:
    finds_the_way_out_of_a_floor(BulletEngine(), name)


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
