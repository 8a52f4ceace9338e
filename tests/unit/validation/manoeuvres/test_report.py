"""The report of a small vehicle: all manoeuvres, published figures beside those that they belong to, as a page and for programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from manoeuvre_rig import GUESS, ROV, TORPEDO, written

from uwserver.scenario.files.errors import ScenarioError
from uwserver.validation.manoeuvres.pages import markdown
from uwserver.validation.manoeuvres.report import Report, as_json, report

PUBLISHED = [
    {**GUESS, "quantity": "ahead_speed_mps", "value": 9.0},
    {**GUESS, "quantity": "ahead_speed_mps", "value": 0.5, "throttle": 0.45},
    {**GUESS, "quantity": "turning_diameter_m", "value": 33.0, "rudder_deg": 12.0},
    {**GUESS, "quantity": "descent_mps", "value": 0.25},
]


@pytest.fixture(scope="module")
def torpedo(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return report(str(written(tmp_path_factory.mktemp("torpedo"), TORPEDO | {"published": PUBLISHED})))


def test_all_manoeuvres_are_there(torpedo: Report) -> None:
    assert [trial.key for trial in torpedo.trials] == [
        "rest", "straight", "turn", "zigzag", "dive", "glide", "sway", "decay", "stop", "energy",
    ]  # fmt: skip
    assert [trial.key for trial in torpedo.trials if trial.reason] == ["glide", "sway"]


def test_a_published_figure_stands_beside_its_own_run(torpedo: Report) -> None:
    beside = {(c.quantity, c.condition): c for c in torpedo.comparisons}
    top, slow = beside["ahead_speed_mps", "ahead 100 %"], beside["ahead_speed_mps", "ahead 45 %"]
    assert (top.published[0].value, slow.published[0].value) == (9.0, 0.5)
    assert top.simulated == torpedo.trial("straight").value("ahead 100 %", "steady")
    assert slow.simulated is not None
    assert top.simulated is not None
    assert slow.simulated < top.simulated
    assert beside["turning_diameter_m", "ahead 100 %, rudder 12 degrees"].published[0].value == 33.0
    assert beside["turning_diameter_m", "ahead 100 %, rudder 15 degrees"].published == ()
    assert beside["descent_mps", "down 100 %"].simulated is None, "published, though the model cannot do it"


def test_the_page_says_what_is_missing_and_what_does_not_apply(torpedo: Report) -> None:
    page = markdown(torpedo, "picture.png")
    assert "![Shapes and thrusters of craft](picture.png)" in page
    assert "| ahead_speed_mps | ahead 100 % | 1.05 | 9 | guess | made up for the test |" in page
    assert "| roll_period_s | roll |" in page
    assert "| none found | - | - |" in page
    assert "Does not apply: nothing pushes it sideways." in page
    assert all(line.count("|") == 5 for line in page.splitlines() if line.startswith(("| mass", "| righting")))


def test_programs_get_plain_values(torpedo: Report) -> None:
    tree = json.loads(json.dumps(as_json(torpedo)))
    assert tree["comparisons"][0]["published"] == [{"value": 9.0, "status": "guess", "source": "made up for the test"}]
    assert tree["trials"][1]["rows"][0]["condition"] == "ahead 30 %"


def test_angles_are_shown_in_degrees_and_kept_in_radians(tmp_path: Path) -> None:
    found = report(str(written(tmp_path, ROV)))
    rate = found.trial("turn").value("on the spot, yaw 100 %", "rate")
    assert rate is not None
    beside = next(c for c in found.comparisons if c.quantity == "spot_turn_rate_degps")
    assert beside.simulated == pytest.approx(rate * 57.29578, rel=1e-6)
    assert f"| {rate * 57.29578:.1f} |" in markdown(found)


def test_a_vehicle_that_there_is_not_is_refused() -> None:
    with pytest.raises(ScenarioError, match="remus100"):
        report("remus")
