"""Every shipped vehicle behaves as its kind does: it goes straight, turns, dives and stops within bounds, and near what is published of it.

Figures are read from the vehicles' pages: `make docs-check` proves that they are what the simulation gives, and runs all manoeuvres once for both.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from page_tables import Table, column, of_vehicle

SHIPPED = Path(__file__).parents[2] / "scenarios" / "uwserver_scenarios" / "vehicles"
ALL = tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))
IDENTIFIED = ("bluerov2_heavy_von_benzon", "bluerov2_wu")
"""A paper's numbers as they stand, for comparison with it; their files say that they are not to be driven."""
VEHICLES = tuple(name for name in ALL if name not in IDENTIFIED)
MOST_TILT, MOST_YAW = 25.0, 20.0
"""Degrees, of a straight run with the throttle stepped, within 20 s: nobody somersaults, and nobody leaves his course."""
NEAR = 0.3
"""Relative distance from published figures: of one maker's class or of another load, never of this very file."""
POWER = "largest power of the water over the energy, 1/s"

Page = dict[str, Table]


@pytest.fixture(scope="module", params=VEHICLES)
def found(request: pytest.FixtureRequest) -> Page:
    return of_vehicle(request.param)


def applying(found: Page, title: str) -> Table:
    """The rows of a trial; skips the test where there are none."""
    if not found[title]:
        pytest.skip("does not apply to this vehicle")
    return found[title]


def length(found: Page) -> float:
    return next(float(row["value"].split(",")[0]) for row in found["Numbers"] if row["number"].startswith("length"))


def test_straight_is_straight(found: Page) -> None:
    straight = applying(found, "Straight line")
    assert {c: t for c, t in column(straight, "largest tilt until then, deg").items() if t > MOST_TILT} == {}
    assert {c: h for c, h in column(straight, "change of heading, deg").items() if abs(h) > MOST_YAW} == {}
    speeds = [v for c, v in column(straight, "steady speed, m/s").items() if c.startswith("ahead")]
    assert speeds == sorted(speeds)
    assert 0.3 < max(speeds) < 5.0


def test_left_alone_it_neither_falls_nor_flies(found: Page) -> None:
    rest = found["Left alone"]
    assert column(rest, "sinks at, m/s").keys() == {"hands off"}
    assert abs(column(rest, "sinks at, m/s")["hands off"]) < 0.3
    assert abs(column(rest, "roll, deg")["hands off"]) < 5.0
    assert abs(column(rest, "pitch, deg")["hands off"]) < 15.0


def test_a_turn_is_to_starboard_and_of_a_size(found: Page) -> None:
    turn = applying(found, "Turning circle")
    assert all(rate > 0.5 for rate in column(turn, "rate of turn, deg/s").values())
    by_rudder = [d for c, d in column(turn, "steady diameter, m").items() if "rudder" in c]
    assert all(1.0 < d / length(found) < 60.0 for d in by_rudder)


def test_it_dives_and_rises_on_command(found: Page) -> None:
    """By the change of depth: one that loops, as the LAUV does with its planes at full speed, may be on its way back at the end."""
    dive = applying(found, "Dive")
    for condition, change in column(dive, "change of depth, m").items():
        down = "down" in condition or "to dive" in condition or "heavy" in condition
        assert (change if down else -change) > 0.1, condition
    assert all(0.005 < abs(rate) < 3.0 for rate in column(dive, "sinks at, m/s").values())


def test_it_swings_back_and_comes_to_rest(found: Page) -> None:
    decay = found["Free decay"]
    assert all(0.2 < period < 60.0 for period in column(decay, "period, s").values())
    assert all(0.0 < ratio < 1.0 for ratio in column(decay, "damping ratio").values())
    assert column(decay, "falls to 1/e after, s").keys() == {"roll", "pitch"}


def test_full_astern_stops_it_sooner_than_no_thrust(found: Page) -> None:
    ways = column(applying(found, "Stop"), "way, m")
    astern = ways["full astern, to a standstill"]
    assert 0.0 < astern < 20.0 * length(found)
    assert astern < ways.get("thrust off, to a tenth of the speed", math.inf)


def test_it_is_near_what_is_published(found: Page) -> None:
    """Of several figures for one condition, as of makers and of papers, one is enough."""
    off: dict[tuple[str, str], list[float]] = {}
    for row in found["Beside the real vehicle"]:
        if row["published"] != "none found":
            figures = off.setdefault((row["quantity"], row["condition"]), [])
            figures.append(abs(float(row["simulated"]) / float(row["published"]) - 1.0))
    assert {compared: figures for compared, figures in off.items() if min(figures) >= NEAR} == {}


@pytest.mark.parametrize("name", ALL)
def test_water_takes_energy_whatever_the_motion(name: str) -> None:
    """At the worst velocity that a search finds, up to speeds where only the terms of second degree count."""
    powers = column(of_vehicle(name)["Energy"], POWER)
    assert len(powers) == 4
    assert {speed: power for speed, power in powers.items() if power >= 0.0} == {}


def test_some_pages_have_what_is_looked_for() -> None:
    """A heading or a column that has another name now is no reason to skip."""
    trials = ("Straight line", "Turning circle", "Dive", "Stop")
    assert {trial: sum(bool(of_vehicle(name)[trial]) for name in VEHICLES) > 12 for trial in trials} == dict.fromkeys(
        trials, True
    )
    compared = [row["published"] for name in VEHICLES for row in of_vehicle(name)["Beside the real vehicle"]]
    assert len([published for published in compared if published != "none found"]) > 12
