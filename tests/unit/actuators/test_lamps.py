"""Lamps as an actuator: levels of named lamps, remembered."""

from __future__ import annotations

from typing import Any

import pytest

from uwserver.actuators import Body, LampsConfig


def body(*lamps: str) -> Body:
    hydro: Any = None
    return Body(hydro, 0, {}, 0, lamps=lamps)


def test_levels_of_all_lamps_in_the_order_of_the_vehicle() -> None:
    lamps = LampsConfig(level=0.25).build(body("left", "right"))
    (field,) = lamps.fields
    assert (field.shape, field.minimum, field.maximum) == ((2,), 0.0, 1.0)
    assert lamps.memory.levels == (0.25, 0.25)
    lamps.apply(((1.0, 0.5),))
    assert (lamps.names, lamps.memory.levels) == (("left", "right"), (1.0, 0.5))
    lamps.neutral()
    assert lamps.memory.levels == (0.25, 0.25)


def test_members_choose_and_a_wrong_one_is_named() -> None:
    assert LampsConfig(members=("right",)).build(body("left", "right")).names == ("right",)
    with pytest.raises(ValueError, match='no lamp "top" here, there are: left, right'):
        LampsConfig(members=("top",)).build(body("left", "right"))
    with pytest.raises(ValueError, match=r"under \[lamps\]"):
        LampsConfig().build(body())
