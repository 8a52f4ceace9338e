"""Verdicts: each fault that is put into an ideal vehicle is found, with its cause."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from manoeuvre_rig import GUESS, ROV, helm, written

from uwserver.validation.manoeuvres.pages import NOTHING, aligned, markdown, plain
from uwserver.validation.manoeuvres.report import Report, report
from uwserver.validation.manoeuvres.runs import Column, Row, Trial
from uwserver.validation.manoeuvres.verdicts import Lines, lines_of, verdicts

AHEAD = ("speed", "tilt", "pitch", "heading", "way", "depth", "steady")


@pytest.fixture(scope="module")
def ideal(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return report(str(written(tmp_path_factory.mktemp("rov"), ROV)))


def changed(change: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    raw = copy.deepcopy(ROV)
    change(raw)
    return raw


def lines(folder: Path, change: Callable[[dict[str, Any]], None] = lambda raw: None) -> Lines:
    return lines_of(helm(folder, changed(change)))


def trials(
    pitch: float = 0.0,
    tilt: float = 0.0,
    heading: float = 0.0,
    rest: tuple[float, float] = (0.0, 0.0),
    energy: float = -1.0,
    dive: str = "down 100 %",
) -> list[Trial]:
    """Runs with these figures at full ahead, left alone, of the energy test, and the name of a dive."""
    row = Row("ahead 100 %", (1.0, tilt, pitch, heading, 20.0, 0.0, 1.0))
    return [
        Trial("rest", "", "", (), (Row("hands off", (*rest, 0.0)),)),
        Trial("straight", "", "", tuple(Column(key, key, "1") for key in AHEAD), (row,)),
        Trial("dive", "", "", (), (Row(dive, ()),)),
        Trial("energy", "", "", (), (Row("", (energy,)),)),
    ]


def told(there: list[Trial], where: Lines, *published: tuple[str, float, float]) -> list[str]:
    return [str(verdict) for verdict in verdicts(there, published, where, floats=False)]


def test_of_an_ideal_vehicle_nothing_stands_out(ideal: Report) -> None:
    assert ideal.verdicts == ()
    assert f"## Verdict\n\n{NOTHING}\n" in markdown(ideal)


def test_thrust_and_drag_act_where_they_are(tmp_path: Path) -> None:
    assert lines(tmp_path).thrust == pytest.approx((0.0, 0.05), abs=1e-6)
    assert lines(tmp_path).drag == (0.0, 0.0)

    def raise_drag(raw: dict[str, Any]) -> None:
        matrix = [[0.0] * 6 for _ in range(6)]
        for k, value in enumerate((100.0, 200.0, 200.0, 10.0, 10.0, 10.0)):
            matrix[k][k] = value
        matrix[4][0] = -10.0  # 10 N m nose down, opposite to a drag of 100 N at z = -0.1 m
        raw["damping"]["quadratic"] = {**GUESS, "matrix": matrix}

    assert lines(tmp_path, raise_drag).drag == pytest.approx((0.0, -0.1))


@pytest.mark.parametrize(
    ("figures", "text"),
    [
        ({"pitch": 0.63}, "leans 36 degrees bow up at full ahead: the centre of thrust is 50 mm below the centre of drag; move the"),
        ({"pitch": -0.63}, "leans 36 degrees bow down at full ahead: the moment of the flow on the hull is larger than that of weight"),
        ({"tilt": 3.0}, "tumbles at full ahead (it tilts by up to 172 degrees): the centre of thrust is 50 mm below"),
        ({"heading": -0.5}, "turns 29 degrees to port within 20 s at full ahead: it does not keep its course by itself"),
        ({"heading": 20.0}, "spins 3.2 times to starboard within 20 s at full ahead"),
        ({"rest": (0.0, 0.1)}, "it lies bow up by 6 degrees when it is left alone; move [buoyancy] center_frd_m along x"),
        ({"rest": (-0.1, 0.0)}, "it lies heeled to port by 6 degrees"),
        ({"energy": 0.2}, "the water drives it: it gains energy at a rate of 0.2 1/s"),
        ({"dive": "planes 5 degrees to dive (it loops)"}, "it loops with planes 5 degrees to dive: the planes are stronger"),
    ],
)  # fmt: skip
def test_a_figure_that_stands_out(figures: dict[str, Any], text: str, tmp_path: Path) -> None:
    (verdict,) = told(trials(**figures), lines(tmp_path))
    assert verdict.startswith(text)


def test_figures_below_the_thresholds_are_let_be(tmp_path: Path) -> None:
    assert told(trials(pitch=0.2, tilt=1.0, heading=0.3, rest=(0.05, -0.05)), lines(tmp_path)) == []


def test_a_surface_vessel_is_not_judged_as_a_submarine(tmp_path: Path) -> None:
    there = trials(pitch=0.5, rest=(0.2, 0.2))
    assert verdicts(there, (), lines(tmp_path), floats=True) == ()


@pytest.mark.parametrize(
    ("place", "heading", "text"),
    [
        (0.1, -1.0, "turns 57 degrees to port within 20 s at full ahead: the centre of thrust is 100 mm to starboard"),
        (-0.1, 1.0, "turns 57 degrees to starboard within 20 s at full ahead: the centre of thrust is 100 mm to port"),
    ],
)
def test_thrust_beside_the_drag_turns_it(place: float, heading: float, text: str, tmp_path: Path) -> None:
    where = lines(tmp_path)
    (verdict,) = told(trials(heading=heading), replace(where, thrust=(place, 0.0)))
    assert verdict.startswith(text)


def set_volume(raw: dict[str, Any]) -> None:
    raw["buoyancy"]["volume_m3"] = 0.11


def set_mass(raw: dict[str, Any]) -> None:
    raw["rigid_body"]["mass_kg"] = 110.0


def set_centre(raw: dict[str, Any]) -> None:
    raw["buoyancy"]["center_frd_m"] = [0.0, 0.0, 0.08]


def set_level(raw: dict[str, Any]) -> None:
    raw["buoyancy"]["center_frd_m"] = [0.0, 0.0, 0.05]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (set_volume, "it rises when it is left alone: it is 101 N too light for this water (10 % of its weight); 0.909 times"),
        (set_mass, "it sinks when it is left alone: it is 73.6 N too heavy for this water (7 % of its weight); 1.073 times"),
        (set_centre, "it turns over when it is let go: the centre of buoyancy lies 30 mm below the centre of gravity"),
        (set_level, "it stays at any angle: the centres of buoyancy and gravity are at the same height"),
    ],
)  # fmt: skip
def test_statics_that_are_wrong(change: Callable[[dict[str, Any]], None], text: str, tmp_path: Path) -> None:
    (verdict,) = told(trials(), lines(tmp_path, change))
    assert verdict.startswith(text)


def test_a_published_speed_that_is_missed_says_how_much_drag_would_give_it(tmp_path: Path) -> None:
    where = lines(tmp_path)
    (verdict,) = told(trials(), where, ("ahead_speed_mps", 2.0, 1.0), ("sway_speed_mps", 1.1, 1.0))
    assert verdict == (
        "ahead speed is 2 mps, published is 1: 100 % too much; 4 times the quadratic damping along this axis, "
        "or 0.25 times the thrust, would give it"
    )
    (verdict,) = told(trials(), where, ("roll_period_s", 1.0, 2.0))
    assert verdict.startswith(
        "roll period is 1 s, published is 2: 50 % too little; look at the numbers with status guess"
    )


# -- the page on a terminal -------------------------------------------------------------------------------------------------------------


def test_a_terminal_gets_aligned_tables_that_fit(ideal: Report) -> None:
    page = plain(ideal, 90, lambda text, style: f"<{style}>{text}</{style}>")
    assert page.startswith("<title>craft</title>\nA box.\n\n<title>Verdict</title>\nNothing stands out")
    assert "|" not in page
    straight = page.partition("<title>Straight line</title>")[2].partition("<title>")[0].splitlines()
    assert len(straight) > 8
    assert max(map(len, straight)) <= 90


def test_columns_are_aligned_and_titles_and_long_cells_are_wrapped() -> None:
    rows = [("ahead 100 %", "1.5", "a source that is much too long for the line"), ("astern", "-", "-")]
    assert aligned(("", "steady speed, m/s", "source"), rows, 50) == [
        "                 steady",
        "             speed, m/s  source",
        "-----------  ----------  -------------------------",
        "ahead 100 %         1.5  a source that is much too",
        "                         long for the line",
        "astern                -  -",
    ]
