"""The table for people and the JSON for programs say the same."""

from __future__ import annotations

import json

from uwserver_bench.report import Report, machine_facts
from uwserver_bench.rows import Row

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
