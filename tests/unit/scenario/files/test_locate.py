from __future__ import annotations

import sys
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwserver.scenario.files.locate import locate

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def test_every_form_of_key_by_hand() -> None:
    text = (
        "# comment with a = 1\n"
        'title = "a # b [x]"  # c = 2\r\n'
        "a.b . 'c d' = 1979-05-27 07:32:00\n"
        'text = """\n'
        "fake = 1\n"
        '[not.a.table] \\""" x"""""\n'
        "lines = [ # one\n"
        "  1,\n"
        "  {x = 2, y.z = [3, 'a]']}, # two\n"
        "]\n"
        "[t.u]\n"
        "  k = ''\n"
        "[[arr]]\n"
        'ä = 1\n'.replace("ä", '"ä\\t"')
        + "[[arr]]\n"
        "[arr.sub]\n"
        "z = true\n"
        "[[arr.deep]]\n"
        "w = '''\n"
        "q = 1'''''\n"
        "last = 0"
    )  # fmt: skip
    places = locate(text)
    assert set(places) == set(paths(tomllib.loads(text)))
    assert places[("title",)] == (2, 1)
    assert places[("a", "b")] == (3, 3)
    assert places[("a", "b", "c d")] == (3, 7)
    assert places[("text",)] == (4, 1)
    assert places[("lines",)] == (7, 1)
    assert places[("lines", 0)] == (8, 3)
    assert places[("lines", 1, "x")] == (9, 4)
    assert places[("lines", 1, "y", "z")] == (9, 13)
    assert places[("lines", 1, "y", "z", 1)] == (9, 21)
    assert places[("t", "u")] == (11, 4)
    assert places[("t", "u", "k")] == (12, 3)
    assert places[("arr", 0, "ä\t")] == (14, 1)
    assert places[("arr", 1)] == (15, 3)
    assert places[("arr", 1, "sub", "z")] == (17, 1)
    assert places[("arr", 1, "deep", 0, "w")] == (19, 1)
    assert places[("arr", 1, "deep", 0, "last")] == (21, 1)


def paths(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    below = [found for key, item in items for found in paths(item, (*path, key))]
    return [path, *below] if path else below


class Writer:
    """Writes TOML and notes where it put each key."""

    def __init__(self, draw: Any) -> None:
        self._draw = draw
        self.text = ""
        self.places: dict[tuple[str | int, ...], tuple[int, int]] = {}

    def put(self, text: str) -> None:
        self.text += text

    def here(self) -> tuple[int, int]:
        return self.text.count("\n") + 1, len(self.text) - self.text.rfind("\n")

    def mark(self, path: tuple[str | int, ...]) -> None:
        self.places.setdefault(path, self.here())

    def choose(self, *options: str) -> None:
        self.put(self._draw(st.sampled_from(options)))

    def key(self, name: str, path: tuple[str | int, ...]) -> None:
        self.mark(path)
        bare = name.isascii() and name.replace("-", "").replace("_", "").isalnum()
        quoted = '"' + name.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t") + '"'
        forms = [quoted] + ([name] if bare else []) + ([f"'{name}'"] if "'" not in name else [])
        self.choose(*forms)

    def value(self, value: Any, path: tuple[str | int, ...]) -> None:
        if isinstance(value, dict):
            self.inline_table(value, path)
        elif isinstance(value, list):
            self.put("[")
            for k, item in enumerate(value):
                self.choose("", " ", "\n  ", "\r\n", " # ] , }\n")
                self.mark((*path, k))
                self.value(item, (*path, k))
                self.choose(",", " , ", ", # [\n") if k < len(value) - 1 else self.choose("", ",", " ,\n")
            self.put("]")
        else:
            self.choose(*SCALARS)

    def inline_table(self, table: dict[str, Any], path: tuple[str | int, ...]) -> None:
        self.put("{")
        for k, (name, item) in enumerate(table.items()):
            self.choose("", " ")
            self.pair(name, item, path)
            self.choose(",", ", ") if k < len(table) - 1 else self.choose("", " ")
        self.put("}")

    def pair(self, name: str, value: Any, path: tuple[str | int, ...]) -> None:
        path = (*path, name)
        self.key(name, path)
        while isinstance(value, dict) and len(value) == 1 and self._draw(st.booleans()):
            ((name, value),) = value.items()
            path = (*path, name)
            self.choose(".", " . ")
            self.key(name, path)
        self.choose("=", " = ", "\t=")
        self.choose("", " ")
        self.value(value, path)

    def table(self, table: dict[str, Any], header: tuple[str, ...], path: tuple[str | int, ...], brackets: int) -> None:
        """Pairs first, then tables and arrays of tables, each with its header."""
        if header:
            self.put("[" * brackets)
            self.choose("", " ")
            spot = self.here()
            for depth, name in enumerate(header, 1):
                spot = self.here()
                self.key(name, self.where(header[:depth], path))
                self.put("." if depth < len(header) else "")
            self.places.setdefault(path, spot)
            self.put("]" * brackets)
            self.line_end()
        later = {}
        for name, value in table.items():
            tabular = isinstance(value, dict) or (
                isinstance(value, list) and value and all(isinstance(v, dict) for v in value)
            )
            if tabular and self._draw(st.booleans()):
                later[name] = value
                continue
            self.choose("", "  ", "\t", "\n", "# a = [\r\n")
            self.pair(name, value, path)
            self.line_end()
        for name, value in later.items():
            if isinstance(value, dict):
                self.table(value, (*header, name), (*path, name), 1)
            else:
                for k, item in enumerate(value):
                    self.table(item, (*header, name), (*path, name, k), 2)

    @staticmethod
    def where(header: tuple[str, ...], path: tuple[str | int, ...]) -> tuple[str | int, ...]:
        """The path of a header's first names: with the array indices between them, without one behind."""
        found: list[str | int] = []
        names = list(header)
        for key in path:
            if not isinstance(key, int):
                if not names:
                    break
                names.pop(0)
            elif not names:
                break
            found.append(key)
        return tuple(found)

    def line_end(self) -> None:
        self.choose("\n", "\r\n", "  \n", " # x = {\n", "\n\n")


SCALARS = (
    "1", "-0.5e3", "true", "inf", "0xF0", "07:32:00", "1979-05-27 07:32:00Z", "''", '""', '"a = [1] # \\" {"', "'\\'",
    '"""\nk = 1\n"""', '"""a""\\"""b"""""', "'''\r\n[t]\n''''", '"""\\\n  x"""', '"ü"',
)  # fmt: skip
NAMES = st.text("abz_-019 .#='\"\\[]{}\täß", min_size=0, max_size=4)
VALUES = st.recursive(
    st.none(), lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3), max_leaves=8
)


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(NAMES, VALUES, max_size=4), st.data())
def test_every_key_is_found_where_it_was_written(tree: dict[str, Any], data: st.DataObject) -> None:
    writer = Writer(data.draw)
    writer.table(tree, (), (), 1)
    tomllib.loads(writer.text)
    assert locate(writer.text) == writer.places


@pytest.mark.parametrize("text", ["", "\n", "# only a comment", "\r\n# x\r\n"])
def test_no_keys(text: str) -> None:
    assert locate(text) == {}
