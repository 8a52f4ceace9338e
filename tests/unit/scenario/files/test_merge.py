"""Raw tables put together: deep where both are tables, whole where one is not, and never in place."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from uwserver.scenario.files.merge import merged, named

BASE: dict[str, Any] = {"a": 1, "t": {"x": 1, "y": {"z": 2}}, "list": [1, 2]}


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ({}, BASE),
        ({"a": 2}, {**BASE, "a": 2}),
        ({"b": 3}, {**BASE, "b": 3}),
        ({"t": {"x": 9}}, {**BASE, "t": {"x": 9, "y": {"z": 2}}}),
        ({"t": {"y": {"w": 1}}}, {**BASE, "t": {"x": 1, "y": {"z": 2, "w": 1}}}),
        ({"t": 5}, {**BASE, "t": 5}),
        ({"a": {"x": 1}}, {**BASE, "a": {"x": 1}}),
        ({"list": [3]}, {**BASE, "list": [3]}),
        ({"t": {}}, BASE),
    ],
)
def test_an_override_goes_in_key_by_key(override: dict[str, Any], expected: dict[str, Any]) -> None:
    base, given = copy.deepcopy(BASE), copy.deepcopy(override)
    assert merged(base, given) == expected
    assert base == BASE
    assert given == override


def test_keys_keep_their_order_and_new_ones_come_last() -> None:
    assert list(merged({"b": 1, "a": 2}, {"c": 3, "a": 4})) == ["b", "a", "c"]


def test_what_is_not_overridden_is_the_same_table() -> None:
    """The loader knows by it that a table was converted already."""
    base = {"same": {"x": 1}, "other": {"y": 2, "deep": {"z": 3}}}
    whole = merged(base, {"other": {"y": 5}})
    assert whole["same"] is base["same"]
    assert whole["other"] is not base["other"]
    assert whole["other"]["deep"] is base["other"]["deep"]


def test_a_table_of_tables_is_empty_where_something_else_stands() -> None:
    raw = {"sensors": {"imu": {}}, "odd": 3, "rows": [{}]}
    assert named(raw, "sensors") is raw["sensors"]
    assert named(raw, "odd") == {}
    assert named(raw, "rows") == {}
    assert named(raw, "nothing") == {}
