"""Ports: sizes, truth, patterns."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwserver.ports import Fault, Field, Port, Refused, Sample, matches, matching, values


@pytest.mark.parametrize(("shape", "size"), [((), 1), ((3,), 3), ((2, 3), 6), ((0,), 0), ((4, 1, 2), 8)])
def test_size_of_a_field(shape, size):
    assert Field("x", "m", "x", shape=shape).size == size


@pytest.mark.parametrize(
    ("path", "truth"),
    [
        ("rov/truth/pose", True),
        ("rov/imu", False),
        ("truth/imu", False),
        ("rov/truth", False),
        ("rov/truthful/x", False),
    ],
)
def test_truth_is_told_by_the_path(path, truth):
    assert Port(path, "sensor", "x", (), "").is_truth is truth


@pytest.mark.parametrize(
    ("pattern", "path", "fits"),
    [
        ("rov/imu", "rov/imu", True),
        ("rov/imu", "rov/imu2", False),
        ("rov", "rov/imu", False),
        ("rov/imu", "rov", False),
        ("*", "rov", True),
        ("*", "rov/imu", False),
        ("*/imu", "rov/imu", True),
        ("rov/*", "rov/imu", True),
        ("rov/*", "rov/truth/pose", False),
        ("rov/*", "rov", False),
        ("*/*/*", "rov/truth/pose", True),
        ("**", "rov", True),
        ("**", "rov/truth/pose", True),
        ("rov/**", "rov", True),
        ("rov/**", "rov/truth/pose", True),
        ("rov/**", "other/truth/pose", False),
        ("**/pose", "rov/truth/pose", True),
        ("**/pose", "pose", True),
        ("**/pose", "rov/truth/pose/x", False),
        ("rov/**/pose", "rov/pose", True),
        ("rov/**/pose", "rov/a/b/pose", True),
        ("**/truth/**", "rov/truth/pose", True),
        ("**/truth/**", "rov/imu", False),
        ("**/**", "rov", True),
        ("**/*", "rov", True),
        ("**/*/*", "rov", False),
        ("**/a/**/a", "a", False),
        ("**/a/**/a", "a/a", True),
        ("i*u", "imu", False),  # a star is a whole level
        ("", "", True),
        ("", "rov", False),
        ("rov/", "rov", False),
    ],
)
def test_patterns(pattern, path, fits):
    assert matches(pattern, path) is fits
    assert matching(pattern, (path, "b/b/b")) == [other for other in (path, "b/b/b") if matches(pattern, other)]


def slow_matches(pattern: list[str], path: list[str]) -> bool:
    """The definition itself, level by level."""
    if not pattern:
        return not path
    if pattern[0] == "**":
        return any(slow_matches(pattern[1:], path[k:]) for k in range(len(path) + 1))
    return bool(path) and pattern[0] in ("*", path[0]) and slow_matches(pattern[1:], path[1:])


@given(
    st.lists(st.sampled_from(["**", "*", "a", "b"]), min_size=1, max_size=6),
    st.lists(st.sampled_from("ab"), min_size=1, max_size=6),
)
def test_patterns_as_defined(pattern, path):
    fits = slow_matches(pattern, path)
    assert matches("/".join(pattern), "/".join(path)) is fits
    assert bool(matching("/".join(pattern), ["/".join(path)])) is fits


@pytest.mark.parametrize("word", ["**", "**/a", "**/*", "**/a/**"])
def test_a_pattern_of_many_stars_takes_bounded_time(word):
    """Sent by anybody who may subscribe. Tried split by split, this would outlast the run of the tests."""
    path = "/".join(["a"] * 400)
    assert not matches("/".join([word] * 200) + "/b", path)
    assert matches("/".join([word] * 200), path)
    assert matching("/".join([word] * 200), [path]) == [path]
    assert matching("/".join([word] * 200), ["a/a/a"] * 1000) == (
        [] if "a" in word or word == "**/*" else ["a/a/a"] * 1000
    )


def test_many_paths_are_not_looked_at_one_by_one(monkeypatch):
    """A describe of a large world, whatever its pattern, takes a microsecond for each of thousands of services."""
    monkeypatch.setattr(values, "_fits", None)
    paths = [f"rov{n}/autopilot/arm" for n in range(2000)]
    assert matching("**/**/rov7/**", paths) == ["rov7/autopilot/arm"]
    assert matching("**/a" * 80, paths) == []
    assert matching("/".join(["**"] * 80), paths) == paths


def test_values_cannot_be_changed():
    sample = Sample("rov/imu", 0, 0, 0, True, (1.0,))
    with pytest.raises(AttributeError):
        sample.seq = 1


def test_a_refusal_carries_its_fault():
    refused = Refused("bad_argument", "what to do", "where")
    assert refused.fault == Fault("bad_argument", "what to do", "where")
    assert str(refused) == "what to do"
