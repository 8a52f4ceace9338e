"""Every shipped vehicle behaves as its kind does: it goes straight, turns, dives and stops within bounds, and near what is published of it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from uwserver.validation.manoeuvres.figures import Trial
from uwserver.validation.manoeuvres.report import Report, report

SHIPPED = Path(__file__).parents[2] / "scenarios" / "uwserver_scenarios" / "vehicles"
IDENTIFIED = {"bluerov2_heavy_von_benzon", "bluerov2_wu"}
"""A paper's numbers as they stand, for comparison with it; their files say that they are not to be driven."""
VEHICLES = tuple(sorted({path.stem for path in SHIPPED.glob("*.toml")} - IDENTIFIED))
MOST_TILT, MOST_YAW = math.radians(25.0), math.radians(20.0)
"""Of a straight run with the throttle stepped, within 20 s: nobody somersaults, and nobody leaves his course."""
NEAR = 0.3
"""Relative distance from published figures: of one maker's class or of another load, never of this very file."""


@pytest.fixture(scope="module", params=VEHICLES)
def found(request: pytest.FixtureRequest) -> Report:
    return report(request.param)


def column(trial: Trial, key: str) -> dict[str, float]:
    """One column by condition; what it did not reach is left out."""
    values = {row.condition: trial.value(row.condition, key) for row in trial.rows}
    return {condition: value for condition, value in values.items() if value is not None}


def length(found: Report) -> float:
    return next((p.values[0] for p in found.particulars if p.name.startswith("length")), 1.0)


def test_straight_is_straight(found: Report) -> None:
    straight = found.trial("straight")
    if straight.reason:
        pytest.skip(straight.reason)
    assert {c: t for c, t in column(straight, "tilt").items() if t > MOST_TILT} == {}
    assert {c: h for c, h in column(straight, "heading").items() if abs(h) > MOST_YAW} == {}
    speeds = {c: v for c, v in column(straight, "steady").items() if c.startswith("ahead")}
    assert list(speeds.values()) == sorted(speeds.values())
    assert 0.3 < max(speeds.values()) < 5.0


def test_left_alone_it_neither_falls_nor_flies(found: Report) -> None:
    rest = found.trial("rest")
    assert abs(rest.value("hands off", "sink") or 0.0) < 0.3
    assert abs(rest.value("hands off", "roll") or 0.0) < math.radians(5.0)
    assert abs(rest.value("hands off", "pitch") or 0.0) < math.radians(15.0)


def test_a_turn_is_to_starboard_and_of_a_size(found: Report) -> None:
    turn = found.trial("turn")
    if turn.reason:
        pytest.skip(turn.reason)
    assert all(rate > math.radians(0.5) for rate in column(turn, "rate").values())
    by_rudder = {c: d for c, d in column(turn, "diameter").items() if "rudder" in c}
    assert all(1.0 < d / length(found) < 60.0 for d in by_rudder.values())


def test_it_dives_and_rises_on_command(found: Report) -> None:
    """By the change of depth: one that loops, as the LAUV does with its planes at full speed, may be on its way back at the end."""
    dive = found.trial("dive")
    for condition, change in column(dive, "depth").items():
        down = "down" in condition or "to dive" in condition or "heavy" in condition
        assert (change if down else -change) > 0.1, condition
    assert all(0.005 < abs(rate) < 3.0 for rate in column(dive, "sink").values())


def test_it_swings_back_and_comes_to_rest(found: Report) -> None:
    decay = found.trial("decay")
    assert all(0.2 < period < 60.0 for period in column(decay, "period").values())
    assert all(0.0 < ratio < 1.0 for ratio in column(decay, "ratio").values())
    assert column(decay, "settle").keys() == {"roll", "pitch"}


def test_full_astern_stops_it_sooner_than_no_thrust(found: Report) -> None:
    stop = found.trial("stop")
    if stop.reason:
        pytest.skip(stop.reason)
    ways = column(stop, "way")
    astern = ways["full astern, to a standstill"]
    assert 0.0 < astern < 20.0 * length(found)
    assert astern < ways.get("thrust off, to a tenth of the speed", math.inf)


def test_it_is_near_what_is_published(found: Report) -> None:
    """Of several figures for one condition, as of makers and of papers, one is enough."""
    for comparison in found.comparisons:
        if comparison.published:
            assert comparison.simulated is not None, comparison
            off = min(abs(comparison.simulated / figure.value - 1.0) for figure in comparison.published)
            assert off < NEAR, comparison
