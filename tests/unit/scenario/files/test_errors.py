"""How faults are written: one line each, all of them, with the number of errors at the end; and what was probably meant."""

from __future__ import annotations

import pytest

from uwserver.scenario.files.errors import (
    KeyPath,
    Problem,
    ScenarioError,
    closest,
    did_you_mean,
    dotted,
    suggestion,
)

WORDS = ("rate_hz", "mount", "latency_s", "enabled")


@pytest.mark.parametrize(
    ("problem", "text"),
    [
        (Problem("a.toml", 3, 7, "world.rate_hz", "too fast"), "a.toml:3:7: world.rate_hz: too fast"),
        (Problem("a.toml", 3, 7, "", "not valid TOML"), "a.toml:3:7: not valid TOML"),
        (Problem("built", 0, 0, "world", "wrong"), "built: world: wrong"),
        (Problem("built", 0, 0, "", "cannot read it"), "built: cannot read it"),
        (Problem("a.toml", 1, 1, "x", "odd", "warning"), "a.toml:1:1: x: warning: odd"),
        (Problem("a.toml", 1, 1, "", "odd", "warning"), "a.toml:1:1: warning: odd"),
    ],
)
def test_a_problem_is_one_line(problem: Problem, text: str) -> None:
    assert str(problem) == text


def test_an_error_lists_all_and_counts_the_errors_only() -> None:
    one, two = Problem("a", 1, 1, "x", "one"), Problem("b", 2, 2, "y", "two")
    doubt = Problem("a", 3, 3, "z", "doubt", "warning")
    error = ScenarioError(iter([one, two, doubt]))
    assert error.problems == (one, two, doubt)
    assert str(error).splitlines() == ["a:1:1: x: one", "b:2:2: y: two", "a:3:3: z: warning: doubt", "2 errors"]


@pytest.mark.parametrize(("count", "last"), [(0, "0 errors"), (1, "1 error"), (2, "2 errors")])
def test_the_number_agrees_with_its_noun(count: int, last: str) -> None:
    problems = [Problem("a", k, 1, "", "x") for k in range(1, count + 1)]
    assert str(ScenarioError(problems)).splitlines()[-1] == last


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ((), ""),
        (("world",), "world"),
        (("world", "clock", "mode"), "world.clock.mode"),
        (("vehicles", "rov", "position_ned_m", 2), "vehicles.rov.position_ned_m[2]"),
        (("curve", 0, 1), "curve[0][1]"),
        (("vehicles", "my rov"), 'vehicles."my rov"'),
        (("a.b", "c"), '"a.b".c'),
        (("a", 'say "x"'), 'a."say \\"x\\""'),
        (("a", "back\\slash"), 'a."back\\\\slash"'),
        (("a", ""), 'a.""'),
        (("a-1", "_b"), "a-1._b"),
        (("ü",), '"ü"'),
    ],
)
def test_a_path_is_written_as_toml_writes_it(path: KeyPath, text: str) -> None:
    assert dotted(path) == text


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("rate_hs", "rate_hz"),
        ("RATE_HZ", "rate_hz"),
        ("mont", "mount"),
        ("latency", "latency_s"),
        ("xyzzy", None),
        ("", None),
    ],
)
def test_what_was_meant(word: str, meant: str | None) -> None:
    assert closest(word, WORDS) == meant
    assert did_you_mean(word, WORDS) == ("" if meant is None else f' (did you mean "{meant}"?)')


def test_the_closest_of_several_is_meant() -> None:
    assert closest("rate", ("rate_hz", "rates", "grate_hz")) == "rates"


def test_where_nothing_is_like_it_all_is_listed() -> None:
    assert suggestion("mont", WORDS) == ' (did you mean "mount"?)'
    assert suggestion("xyzzy", WORDS) == "; allowed: rate_hz, mount, latency_s, enabled"
    assert suggestion("xyzzy", ()) == "; allowed: none"
    assert suggestion("xyzzy", ("left", "right"), "; there are: ") == "; there are: left, right"
