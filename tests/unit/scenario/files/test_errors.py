"""How problems are written: one line each, with the number of errors at the end; similar words; types and values in the words of a TOML file."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta, UnsetType

from uwserver.scenario.files.errors import (
    KeyPath,
    Problem,
    ScenarioError,
    closest,
    did_you_mean,
    dotted,
    expected,
    found,
    not_built,
    number,
    suggestion,
)
from uwserver.sensors import ImuConfig
from uwserver.table import Name, NonNegative, Positive, Probability, Vector3

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


@pytest.mark.parametrize(
    ("type_", "text"),
    [
        (float, "a number"),
        (int, "a whole number"),
        (bool, "true or false"),
        (str, "a string"),
        (Name, "a string that is not empty"),
        (Positive, "a number greater than 0"),
        (NonNegative, "a number of at least 0"),
        (Probability, "a number from 0 to 1"),
        (Annotated[float, Meta(lt=2.5)], "a number less than 2.5"),
        (Annotated[float, Meta(le=2)], "a number of at most 2"),
        (Annotated[float, Meta(gt=0, lt=180)], "a number greater than 0 and less than 180"),
        (Annotated[int, Meta(ge=1, le=65535)], "a whole number from 1 to 65535"),
        (Literal["a"], '"a"'),
        (Literal["a", "b"], 'one of "a", "b"'),
        (Literal[1], "1"),
        (Vector3, "an array of 3 (a number each)"),
        (tuple[int, ...], "an array (a whole number each)"),
        (list[str], "an array (a string each)"),
        (Annotated[tuple[Name, ...], Meta(min_length=2)], "an array of at least 2 (a string that is not empty each)"),
        (float | tuple[float, ...], "a number or an array (a number each)"),
        (Positive | UnsetType, "a number greater than 0"),
        (str | None, "a string"),
        (dict[str, float], "a table"),
        (ImuConfig, "a table"),
    ],
)
def test_what_is_expected(type_: Any, text: str) -> None:
    assert expected(type_) == text


@pytest.mark.parametrize(
    ("raw", "text"),
    [
        (True, "the boolean true"),
        (False, "the boolean false"),
        ("x", 'the string "x"'),
        ("", 'the string ""'),
        ("a" * 40, f'the string "{"a" * 40}"'),
        ("a" * 41, f'the string "{"a" * 37}..."'),
        ([], "an array of 0"),
        ((1, 2), "an array of 2"),
        ({}, "a table"),
        (3, "3"),
        (2.5, "2.5"),
        (1e300, "1e+300"),
        (datetime.date(2026, 1, 1), "a date"),
        (datetime.time(1, 2), "a time"),
    ],
)
def test_what_is_found(raw: object, text: str) -> None:
    assert found(raw) == text


@pytest.mark.parametrize(
    ("raw", "text"),
    [(0, "0"), (-7, "-7"), (10**20 - 1, "9" * 20), (10**20, "an integer of 67 bits"), (-(10**30), "an integer of 100 bits"), (0.1, "0.1")],
)  # fmt: skip
def test_very_long_integers_are_cut(raw: float, text: str) -> None:
    assert number(raw) == text


def test_a_component_that_fails_is_told_with_kind_file_line_and_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Odd(msgspec.Struct, tag="odd", tag_field="kind"):
        pass

    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.py"
    path.write_text("def build():\n    return 1 / 0\n")
    names: dict[str, Any] = {}
    exec(compile(path.read_text(), str(path), "exec"), names)
    with pytest.raises(ZeroDivisionError) as caught:
        names["build"]()
    text = 'a component of kind "odd" cannot be built (mine.py:2): ZeroDivisionError: division by zero'
    assert not_built(Odd(), caught.value) == text
