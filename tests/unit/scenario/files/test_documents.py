"""Files are found, opened only where reading them ends, parsed and merged; problems are placed at keys, or at the nearest table around them."""

from __future__ import annotations

import copy
import os
from pathlib import Path
from typing import Any

import pytest

from uwserver.scenario.files import documents
from uwserver.scenario.files.documents import (
    Document,
    find,
    from_tables,
    is_plain,
    label_of,
    merged,
    named,
    opened,
    parse,
    read,
    read_whole,
    shipped,
)
from uwserver.scenario.files.errors import Problem, ScenarioError

TEXT = 'schema = 1\n[world]\nrate_hz = 240\nrow = [1, 2]\n[vehicles.rov]\nmodel = "x"\n'


@pytest.fixture
def document() -> Document:
    return parse(TEXT, "a.toml", Path("/nowhere/a.toml"))


@pytest.fixture
def failures() -> list[str]:
    return []


# -- places -----------------------------------------------------------------------------------------------------------------------------


def test_a_problem_stands_at_its_key(document: Document) -> None:
    assert document.problem(("world", "rate_hz"), "bad") == Problem("a.toml", 3, 1, "world.rate_hz", "bad")
    assert document.problem(("world", "row", 1), "bad") == Problem("a.toml", 4, 11, "world.row[1]", "bad")


def test_a_problem_of_what_is_not_there_stands_at_the_nearest_table(document: Document) -> None:
    assert document.problem(("vehicles", "rov", "sensors", "imu"), "x").line == 5
    missing = document.problem(("server", "name"), "x")
    assert (missing.line, missing.column, missing.path) == (1, 1, "server.name")


def test_a_problem_can_point_at_another_key(document: Document) -> None:
    problem = document.problem(("vehicles", "rov"), "misspelt", ("vehicles", "rov", "model"), "warning")
    assert (problem.line, problem.path, problem.severity) == (6, "vehicles.rov", "warning")


def test_what_was_built_in_python_has_no_places() -> None:
    built = from_tables({"a": {"b": [{"c": 1}]}}, "mine")
    assert built.path is None
    assert built.locations[("a", "b", 0, "c")] == (0, 0)
    assert str(built.problem(("a", "b", 0, "c"), "bad")) == "mine: a.b[0].c: bad"
    assert str(built.problem(("z",), "bad")) == "mine: z: bad"


# -- reading ----------------------------------------------------------------------------------------------------------------------------


def test_a_file_is_read_with_its_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(TEXT)
    document = read(Path("a.toml"))
    assert document.label == "a.toml"
    assert document.path == tmp_path / "a.toml"
    assert document.raw["world"] == {"rate_hz": 240, "row": [1, 2]}


def test_a_mark_of_utf_8_at_the_beginning_does_not_matter(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfschema = 1\n")
    document = read(tmp_path / "a.toml")
    assert document.raw == {"schema": 1}
    assert document.locations[("schema",)] == (1, 1)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"a = 1\nb = \xff\n", "a.toml:2:5: byte 0xff is not valid UTF-8: save the file as UTF-8"),
        (b"\xe4", "a.toml:1:1: byte 0xe4 is not valid UTF-8"),
        (b"a =", "a.toml:1:4: not valid TOML: invalid value"),
        (b"a = 1\na = 2\n", "a.toml:2:6: not valid TOML: cannot overwrite a value"),
        (b'a = "x', "a.toml:1:7: not valid TOML: unterminated string"),
        (b"x = " + b"[" * 9000, "a.toml:1:1: not valid TOML: nested too deeply"),
    ],
)
def test_what_cannot_be_read_is_told_with_its_position(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_bytes(content)
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path / "a.toml")
    (problem,) = caught.value.problems
    assert str(problem).startswith(text)


def test_a_file_that_is_not_there_and_a_folder_are_told(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(ScenarioError, match="cannot read it: "):
            read(path)


# -- finding ----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("folder", "name"), [("", "bluerov2_pool"), ("vehicles", "bluerov2_heavy"), ("devices", "t200")]
)
def test_a_shipped_file_is_found_by_its_name(tmp_path: Path, failures: list[str], folder: str, name: str) -> None:
    path = find(name, folder, tmp_path, failures.append)
    assert path == shipped(folder)[name]
    assert path is not None
    assert path.stem == name
    assert failures == []


def test_shipped_files_are_sorted_and_of_one_folder() -> None:
    names = list(shipped())
    assert names == sorted(names)
    assert "one_of_everything" in names
    assert not set(names) & set(shipped("vehicles"))
    assert all(path.suffix == ".toml" and path.is_file() for path in shipped("devices").values())


@pytest.mark.parametrize("reference", ["mine.toml", "./mine.toml", "sub/mine.toml", "sub/../mine.toml"])
def test_a_path_starts_beside_the_file_that_names_it(tmp_path: Path, failures: list[str], reference: str) -> None:
    (tmp_path / "sub").mkdir()
    for path in (tmp_path / "mine.toml", tmp_path / "sub/mine.toml"):
        path.write_text("")
    found = find(reference, "vehicles", tmp_path, failures.append)
    assert found == tmp_path / reference
    assert failures == []


@pytest.mark.parametrize(
    ("reference", "folder", "text"),
    [
        ("nowhere.toml", "", 'there is no scenario file "nowhere.toml"'),
        ("./nowhere", "vehicles", 'there is no vehicle file "nowhere"'),
        ("sub\\x", "devices", 'there is no device file "sub\\x"'),
        ("bluerov3", "vehicles", 'unknown vehicle "bluerov3" (did you mean "bluerov2"?); shipped: '),
        ("xyzzy", "", 'unknown scenario "xyzzy"; shipped: bluerov2_'),
        ("t20", "devices", 'unknown device "t20" (did you mean "t200"?)'),
        ("", "devices", 'unknown device ""; shipped: '),
    ],
)
def test_what_is_not_there_is_told_with_what_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failures: list[str], reference: str, folder: str, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert find(reference, folder, tmp_path, failures.append) is None
    (told,) = failures
    assert told.startswith(text)
    assert told.endswith('for a file of your own write its path with ".toml"') == ("shipped" in told)


def test_a_shipped_name_of_another_folder_is_not_found(tmp_path: Path, failures: list[str]) -> None:
    assert find("t200", "vehicles", tmp_path, failures.append) is None


def test_a_label_is_relative_below_the_working_folder_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "in").mkdir()
    monkeypatch.chdir(tmp_path / "in")
    assert label_of(Path("a.toml")) == "a.toml"
    assert label_of(tmp_path / "in" / "b" / "a.toml") == str(Path("b", "a.toml"))
    assert label_of(tmp_path / "a.toml") == str(tmp_path / "a.toml")


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


def test_a_file_is_read_whole_up_to_its_limit(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    assert read_whole(tmp_path / "a", 5) == b"12345"
    with pytest.raises(OSError, match="it has 5 bytes; at most 4 are allowed"):
        read_whole(tmp_path / "a", 4)


def test_a_file_that_grows_is_not_half_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    look = os.fstat

    def look_and_grow(descriptor: int) -> os.stat_result:
        seen = look(descriptor)
        with (tmp_path / "a").open("ab") as file:
            file.write(b"6")
        return seen

    monkeypatch.setattr(documents.os, "fstat", look_and_grow)
    with pytest.raises(OSError, match="it grew while it was read"):
        read_whole(tmp_path / "a", 100)


def test_no_descriptor_is_left_of_what_is_no_file(tmp_path: Path) -> None:
    before = len(list(Path("/dev/fd").iterdir()))
    for _ in range(20):
        with pytest.raises(OSError, match="not a regular file"), opened(tmp_path):
            pass
    assert len(list(Path("/dev/fd").iterdir())) == before


@pytest.mark.parametrize("name", ["a\0b", "\ud800", "a" * 5000])
def test_a_name_that_no_file_can_have(name: str, tmp_path: Path) -> None:
    assert not is_plain(tmp_path / name)
    with pytest.raises(OSError, match=r"a file cannot have this name|File name too long"), opened(tmp_path / name):
        pass
