"""Verdicts of constructed pairs, and the report of them."""

from __future__ import annotations

import json

import pytest
from uwserver_bench.against.figures import MARGIN, Comparison, Figure

FACTS = {"folder": "/a/uwserver", "python": "3.11.7", "packages": {"uwserver": "0.1.0"}, "distributions": 60}
OTHER = {**FACTS, "folder": "/b/uwserver"}


def figure(ratios: list[float], bar: float | None = None, theirs: float = 2.0) -> Figure:
    return Figure("ticks", "a tick", "us", tuple(r * theirs for r in ratios), (theirs,) * len(ratios), bar)


def around(ratio: float, spread: float) -> list[float]:
    return [ratio + spread * (k - 7) / 7 for k in range(15)]


@pytest.mark.parametrize(
    ("ratios", "verdict"),
    [
        (around(1.0, 0.02), "ok"),
        (around(1.04, 0.005), "ok"),
        (around(1.2, 0.02), "worse"),
        (around(1.06, 0.005), "worse"),
        (around(1.2, 0.6), "open"),
        (around(1.0, 0.3), "open"),
        (around(0.8, 0.1), "better"),
        (around(0.96, 0.03), "ok"),
    ],
)
def test_the_interval_judges_a_cost(ratios: list[float], verdict: str) -> None:
    assert figure(ratios).verdict == verdict


def test_three_wild_pairs_of_fifteen_do_not_decide() -> None:
    assert figure([1.0] * 12 + [9.0] * 3).verdict == "ok"
    assert figure([1.2] * 12 + [0.1] * 3).verdict == "worse"


def test_the_whole_interval_must_lie_above_the_margin() -> None:
    assert figure([MARGIN] * 15).verdict == "ok"
    assert figure([MARGIN] * 4 + [2.0] * 11).verdict == "open"
    assert figure([MARGIN] * 3 + [2.0] * 12).verdict == "worse"


def test_too_few_pairs_are_never_worse() -> None:
    assert figure([3.0] * 5).verdict == "few"
    assert figure([3.0] * 6).verdict == "worse"


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict"), [(0.9, 0.1, "ok"), (1.0, 9.0, "ok"), (1.1, 0.9, "worse"), (1.1, 1.2, "both miss")]
)
def test_a_latency_is_judged_by_its_bar_whatever_the_ratio(ours: float, theirs: float, verdict: str) -> None:
    assert Figure("latencies", "a reply", "ms", (ours,) * 15, (theirs,) * 15, bar=1.0).verdict == verdict


def test_a_latency_that_misses_its_bar_by_chance_alone_is_open() -> None:
    assert figure(around(1.05, 0.3), bar=2.05).verdict == "open"
    assert figure(around(1.5, 0.3), bar=2.05).verdict == "worse"
    assert figure([1.5] * 5, bar=2.05).verdict == "few"


def test_what_could_not_be_measured_has_no_verdict() -> None:
    absent = Figure("ticks", "a tick", "us", (), (), note="their version: no such sensor")
    assert absent.verdict == "absent"
    assert "no such sensor" in Comparison(False, 15, {}, {"ours": FACTS, "theirs": OTHER}, (absent,)).table()


def test_a_cost_of_nothing_makes_no_ratio() -> None:
    assert Figure("ticks", "a tick", "us", (1.0, 3.0), (0.0, 2.0)).ratios == (1.5,)


def test_ratios_are_of_pairs_not_of_medians() -> None:
    slow_machine = Figure("ticks", "a tick", "us", (1.0, 10.0, 100.0), (2.0, 20.0, 200.0))
    assert slow_machine.ratios == (0.5, 0.5, 0.5)


def test_the_report_names_what_is_worse_and_why() -> None:
    comparison = Comparison(
        False, 15, {"cpu": "x"}, {"ours": FACTS, "theirs": OTHER}, (figure(around(1.0, 0.02)), figure(around(1.2, 0.02)))
    )  # fmt: skip
    assert len(comparison.worse) == 1
    table = comparison.table()
    assert "/a/uwserver" in table
    assert "/b/uwserver" in table
    assert "worse: 1 of 2" in table
    assert "1.189 .. 1.211" in table
    report = json.loads(json.dumps(comparison.as_json()))
    assert [f["verdict"] for f in report["figures"]] == ["ok", "worse"]
    assert report["figures"][1]["ratio"] == pytest.approx(1.2)
    assert report["figures"][1]["interval"] == pytest.approx([1.2 - 0.08 / 7, 1.2 + 0.08 / 7])
    assert len(report["figures"][1]["ours"]) == 15


def test_the_report_says_when_the_sides_are_one_or_unlike() -> None:
    def table(theirs: dict) -> str:
        return Comparison(False, 15, {}, {"ours": FACTS, "theirs": theirs}, (figure([1.0] * 15),)).table()

    assert "same installation" in table(FACTS)
    assert "same installation" not in table(OTHER)
    assert "differs" in table({**OTHER, "python": "3.10.1"})
    assert "differs" not in table(OTHER)
