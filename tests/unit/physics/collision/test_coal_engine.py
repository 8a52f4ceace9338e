"""What coal says about shapes that overlap."""

from __future__ import annotations

import pytest
from engine_rig import SUNK, finds_the_way_out_of_a_floor

from uwserver.physics.collision.coal_engine import CoalEngine

pytest.importorskip("coal")


@pytest.mark.parametrize("name", SUNK)
def test_the_way_out_of_a_floor_is_up(name: str) -> None:
    finds_the_way_out_of_a_floor(CoalEngine(), name)
