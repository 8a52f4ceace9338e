"""Bodies and water as parts: what they save, and what they refuse."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uwserver.world.bodies.bodies_and_water import Bodies, WaterPart, WaterState
from uwserver.world.parts.part import is_awake
from uwserver.world.world import World


def flowing() -> tuple[WaterPart, Any, list[Any]]:
    """With one drifting current."""
    sea = SimpleNamespace(drifts=(SimpleNamespace(rng=np.random.default_rng(3), ends=np.arange(6.0).reshape(2, 3)),))
    currents = list[Any]()
    water: Any = SimpleNamespace(sea=sea, current=(0.1, 0.2, 0.0))
    return WaterPart(water, currents.append), sea, currents


def test_still_water_keeps_its_current_alone() -> None:
    still: Any = SimpleNamespace(sea=None, current=(0.0, 0.5, 0.0))
    part = WaterPart(still, lambda _: None)
    assert not is_awake(part), "nothing of it is done in Python in a tick"
    assert part.save() == WaterState((0.0, 0.5, 0.0), ())


def test_a_drifting_current_goes_on_from_its_state() -> None:
    part, sea, currents = flowing()
    kept, drift = part.save(), sea.drifts[0]
    part.check(kept)
    drawn = drift.rng.standard_normal(4).tolist()
    drift.ends[:] = 9.0
    part.load(kept)
    assert drift.ends.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert drift.rng.standard_normal(4).tolist() == drawn
    assert currents == [(0.1, 0.2, 0.0)]


@pytest.mark.parametrize(
    ("state", "text"),
    [
        (WaterState((0.0, 0.0, 0.0), ()), "0 drifting currents, not 1"),
        (WaterState((0.0, 0.0, 0.0), ((bytes(9), (0.0,) * 6),)), "random stream"),
        (WaterState((0.0, 0.0, 0.0), ((bytes(16), (0.0,) * 3),)), "two velocities"),
        (WaterState((0.0, 1e3, 0.0), ((bytes(16), (0.0,) * 6),)), "faster"),
        (WaterState((0.0, 0.0, 0.0), ((bytes(16), (float("nan"),) * 6),)), "faster"),
    ],
)
def test_water_that_cannot_be_is_refused(state: WaterState, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        flowing()[0].check(state)


def test_bodies_come_back_bit_for_bit_and_the_state_is_a_copy(world: World) -> None:
    world.command("rov/thrusters", u=[0.3] * 8)
    world.step(20)
    part = world.parts["world/bodies"]
    assert isinstance(part, Bodies)
    kept = part.save()
    expected = {name: getattr(world.hydro, name).tobytes() for name in ("state", "bodies", "thrusters")}
    world.step(20)
    assert world.hydro.state.tobytes() != expected["state"]
    part.check(kept)
    part.load(kept)
    assert {name: getattr(world.hydro, name).tobytes() for name in expected} == expected


def test_the_rows_of_bodies_are_put_back_before_all_others(world: World) -> None:
    assert next(iter(world.parts)) == "world/bodies"
    assert list(world.parts)[1:] == sorted(list(world.parts)[1:])
