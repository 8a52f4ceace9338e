"""What coal says about shapes that overlap."""

from __future__ import annotations

import pytest
from engine_rig import SHAPES, SUNK, finds_the_way_out_of_a_floor, forgets_what_was_removed

from uwserver.physics.collision.coal_engine import CoalEngine

pytest.importorskip("coal")


@pytest.mark.parametrize("name", SUNK)
def test_the_way_out_of_a_floor_is_up(name: str) -> None:
    finds_the_way_out_of_a_floor(CoalEngine(), name)


@pytest.mark.parametrize("shape", SHAPES)
def test_what_was_removed_is_gone_and_the_others_stay(shape: str) -> None:
    forgets_what_was_removed(CoalEngine(), SHAPES[shape])
