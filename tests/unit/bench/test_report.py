"""Verdicts of figures, and the report of them."""

from __future__ import annotations

import json

import pytest
from uwserver_bench.report import Report, Row, machine_facts, quantile


def row(*values: float, **bars: float) -> Row:
    return Row("physics", "a case", "ms", values, **bars)


def test_the_median_is_judged_not_the_best_or_the_mean() -> None:
    assert row(1.0, 9.0, 100.0).value == 9.0
    assert row(1.0, 9.0, 100.0, at_most=10.0).verdict == "ok"
    assert row(1.0, 11.0, 2.0, at_least=5.0).verdict == "miss"


@pytest.mark.parametrize(("value", "verdict"), [(9.9, "miss"), (10.0, "ok"), (10.1, "ok")])
def test_at_least_includes_the_bar(value: float, verdict: str) -> None:
    assert row(value, at_least=10.0).verdict == verdict


@pytest.mark.parametrize(("value", "verdict"), [(9.9, "ok"), (10.0, "ok"), (10.1, "miss")])
def test_at_most_includes_the_bar(value: float, verdict: str) -> None:
    assert row(value, at_most=10.0).verdict == verdict


def test_without_a_bar_it_informs_and_without_values_it_is_absent() -> None:
    assert row(1.0).verdict == "info"
    assert row(at_least=1.0).verdict == "absent"
    assert row().value is None


@pytest.mark.parametrize(("part", "expected"), [(0.0, 1), (0.5, 50), (0.99, 99), (0.991, 100), (1.0, 100)])
def test_quantile_is_the_smallest_value_that_covers_the_part(part: float, expected: int) -> None:
    assert quantile(range(100, 0, -1), part) == expected


def test_quantile_of_one_value_is_that_value() -> None:
    assert quantile([7.0], 0.99) == 7.0


MACHINE = machine_facts()
FAST = Row("physics", "fast enough", "x realtime", (210.0, 250.0, 190.0), at_least=200.0)
SLOW = Row("server", "too slow", "ms", (1.5,), at_most=1.0)
GONE = Row("physics", "a peer", "x realtime", (), note="not installed: pip install peer")


def lines(*rows: Row, quick: bool = False) -> list[str]:
    return Report(quick, MACHINE, rows).table().splitlines()


def the_line(name: str, *rows: Row) -> str:
    return next(line for line in lines(*rows) if line.startswith(name))


def test_a_line_holds_median_bar_verdict_and_spread() -> None:
    line = the_line("fast enough", FAST, SLOW)
    assert line.split()[2:] == ["210", "x", "realtime", ">=", "200", "ok", "(190", "..", "250)"]
    assert the_line("too slow", FAST, SLOW).split()[2:] == ["1.5", "ms", "<=", "1", "miss"]


def test_the_end_names_what_misses() -> None:
    assert lines(FAST, SLOW)[-1] == "missed its bar: server: too slow"
    assert lines(FAST, GONE)[-1] == "every bar is met"


def test_a_missing_peer_tells_how_to_install_it() -> None:
    assert the_line("a peer", FAST, GONE).endswith("not installed: pip install peer")


def test_quick_warns_that_speed_cannot_be_judged() -> None:
    assert any("--quick" in line for line in lines(FAST, quick=True))
    assert not any("--quick" in line for line in lines(FAST))


def test_json_holds_every_repeat_and_the_machine() -> None:
    plain = json.loads(json.dumps(Report(False, MACHINE, (FAST, GONE)).as_json()))
    assert plain["format"] == "uwserver-bench-1"
    assert set(plain["machine"]) >= {"cpu", "cores", "python", "versions", "load_average_1min"}
    assert plain["machine"]["versions"]["numpy"]
    first, second = plain["rows"]
    assert (first["values"], first["median"], first["verdict"]) == ([210.0, 250.0, 190.0], 210.0, "ok")
    assert (second["values"], second["median"], second["verdict"]) == ([], None, "absent")
