"""The converter on types of its own: what it accepts is what msgspec would, and it tells every fault."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import pytest

from uwserver.scenario.files.convert import Converter, Node, NodeCache, convert
from uwserver.scenario.files.errors import KeyPath, dotted
from uwserver.table import Positive, Table


class Round(Table, tag="round", tag_field="kind", kw_only=True):
    radius: Positive


class Square(Table, tag="square", tag_field="kind", kw_only=True):
    side: Positive = 1.0
    mode: Literal["a", "b"] = "a"


class Limits(Table, kw_only=True):
    low: float
    high: float

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise ValueError("low is above high")


class Everything(Table, kw_only=True):
    count: int
    name: str | msgspec.UnsetType = msgspec.UNSET
    value: float | tuple[float, ...] = 0.0
    members: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)] | None = None
    shapes: dict[str, Round | Square] = msgspec.field(default_factory=dict)
    rows: list[tuple[int, int]] = msgspec.field(default_factory=list)
    limits: list[Limits] = msgspec.field(default_factory=list)
    free: dict[str, Any] = msgspec.field(default_factory=dict)
    numbers: dict[str, float] = msgspec.field(default_factory=dict)


def faults(raw: object, type_: Any = Everything) -> list[tuple[str, str]]:
    told: list[tuple[str, str]] = []

    def report(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        told.append((dotted(path if at is None else at), text))

    assert (convert(raw, type_, (), report) is None) == bool(told)
    return told


def test_good_tables_come_out_as_msgspec_would_make_them() -> None:
    raw = {
        "count": 2,
        "name": "n",
        "value": [1, 2.5],
        "members": ["a"],
        "shapes": {"r": {"kind": "round", "radius": 2}, "s-1": {"kind": "square"}},
        "rows": [[1, 2], [3, 4]],
        "limits": [{"low": 1, "high": 2}],
        "free": {"any thing": [1, "x"]},
        "numbers": {"a": 1},
    }
    assert faults(raw) == []
    assert convert(raw, Everything, (), lambda *_: None) == msgspec.convert(raw, Everything)


def test_all_faults_are_told() -> None:
    raw = {
        "cuont": 2,
        "value": [1, "x"],
        "members": [],
        "shapes": {"r": {"kind": "round"}, "1": {"kind": "square", "mode": "c"}, "t": {"kind": "triangle"}, "u": 3},
        "rows": [[1, 2, 3], [1, 2.0]],
        "limits": [{"low": 3, "high": 2}],
        "numbers": {"a": True, "b": float("-inf")},
    }
    assert faults(raw) == [
        ("cuont", 'unknown key "cuont" (did you mean "count"?)'),
        ("value[1]", 'expected a number, found the string "x"'),
        ("members", "expected an array of at least 1 (a string each), found an array of 0"),
        ("shapes.r", 'missing key "radius"'),
        ("shapes.1.mode", 'expected one of "a", "b", found the string "c"'),
        ("shapes.1", '"1" cannot be a name: begin with a letter or _, then use letters, digits, _ and - (it is part of a path)'),
        ("shapes.t.kind", 'unknown kind "triangle"; allowed: round, square'),
        ("shapes.u", "expected a table, found 3"),
        ("rows[0]", "expected an array of 2 (a whole number each), found an array of 3"),
        ("rows[1][1]", "expected a whole number, found 2.0"),
        ("limits[0]", "low is above high"),
        ("numbers.a", "expected a number, found the boolean true"),
        ("numbers.b", "expected a number, found -inf: it must be finite"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("raw", "text"),
    [
        ({"knd": "round", "radius": 1}, 'unknown key "knd" (did you mean "kind"?)'),
        ({"radius": 1}, 'missing key "kind"; allowed: round, square'),
        ({"kind": "round", "radius": 0}, "expected a number greater than 0, found 0"),
        ({"kind": "round", "radius": 1, "side": 1}, 'unknown key "side"; allowed: radius, kind'),
        ([], "expected a table, found an array of 0"),
    ],
)
def test_tagged_union(raw: object, text: str) -> None:
    assert [told for _, told in faults(raw, Round | Square)] == [text]


def test_union_of_number_and_array_says_which_it_took() -> None:
    assert faults({"count": 1, "value": "x"}) == [("value", 'expected a number, found the string "x"')]
    assert faults({"count": 1, "value": {}}) == [("value", "expected a number, found a table")]


# -- the tree ---------------------------------------------------------------------------------------------------------------------------


def tree_of(raw: object, type_: Any = Everything) -> Node:
    return Converter(lambda *_: None).tree(raw, type_)


def test_a_fault_is_a_hole_and_what_stands_beside_it_is_there() -> None:
    raw = {"count": "x", "shapes": {"r": {"kind": "round"}, "s": {"kind": "square", "side": 3}}, "name": "n"}
    tree = tree_of(raw)
    assert tree.value is None
    assert tree.at("shapes").value is None
    assert tree.at("name").value == "n"
    assert tree.values("shapes") == {"s": Square(side=3.0)}
    assert list(tree.at("shapes").parts) == ["r", "s"]
    assert tree.at("shapes", "s", "side").value == 3.0


def test_what_is_not_there_is_no_part_and_has_no_value() -> None:
    tree = tree_of({"count": 1})
    assert "name" not in tree.parts
    assert tree.at("name").value is None
    assert tree.at("shapes", "r", "radius") == Node(None)
    assert tree.values("shapes") == {}


def test_a_default_that_is_a_table_is_a_part() -> None:
    class Outer(Table, kw_only=True):
        inner: Square = Square(side=7.0)

    assert tree_of({}, Outer).at("inner").value == Square(side=7.0)
    assert tree_of({"inner": 3}, Outer).at("inner").value is None


def test_a_table_that_refuses_itself_keeps_its_parts() -> None:
    tree = tree_of({"low": 3.0, "high": 2.0}, Limits)
    assert tree.value is None
    assert (tree.at("low").value, tree.at("high").value) == (3.0, 2.0)


def test_a_table_of_two_files_is_converted_and_told_once() -> None:
    told: list[str] = []
    known: NodeCache = {}
    shared = {"kind": "round", "radius": -1}

    def report(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        told.append(dotted(path))

    first = Converter(report, known=known).tree({"count": 1, "shapes": {"a": shared}}, Everything)
    second = Converter(report, known=known).tree({"count": 2, "shapes": {"b": shared}}, Everything)
    assert told == ["shapes.a.radius"]
    assert first.at("shapes", "a") is second.at("shapes", "b")
    assert second.value is None


def test_a_table_that_is_read_as_two_types_is_converted_as_each() -> None:
    known: NodeCache = {}
    raw = {"low": 1.0, "high": 2.0}
    converter = Converter(lambda *_: None, known=known)
    assert converter.tree(raw, Limits).value == Limits(low=1.0, high=2.0)
    assert converter.tree(raw, dict[str, float]).value == raw
