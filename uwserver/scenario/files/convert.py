"""Converts raw TOML tables to a tree of typed tables. A table with an error becomes a hole (None), so that one error does not hide others."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, Protocol, Union, get_args, get_origin

import msgspec
from msgspec.structs import FieldInfo

from uwserver.scenario.files.errors import KeyPath, closest, did_you_mean, expected, found, suggestion
from uwserver.scenario.files.words import translation, word_here

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
"""Form of a table name, which becomes one level of a path on every wire."""


class Report(Protocol):
    """Reports one error or warning about the value at `path`; `at` is the key to point at if that is another one."""

    def __call__(self, path: KeyPath, text: str, at: KeyPath | None = None) -> None: ...


More = Mapping[type, Mapping[str, Any]]
"""Additional kinds for unions, by base class: they belong to every union whose members derive from it. Structs by their `kind`."""
NO_MORE: More = {}


class Node(NamedTuple):
    """One converted value of a file, with all that is below it.

    Attributes:
        value: typed; None (a hole) if it or anything below it has an error.
        parts: parts of a table: all values that the file gives, holes too, and defaults that are tables.
    """

    value: Any
    parts: Mapping[str, Node] = {}

    def at(self, *path: str) -> Node:
        """Return the node further down; one without value and parts if nothing is given there."""
        node = self
        for key in path:
            node = node.parts.get(key, _NOTHING)
        return node

    def names(self, *path: str) -> tuple[str, ...]:
        """Return the names in a table of tables further down, holes too."""
        return tuple(self.at(*path).parts)

    def values(self, *path: str) -> dict[str, Any]:
        """Return the values of a table of tables further down, without its holes."""
        return {name: part.value for name, part in self.at(*path).parts.items() if part.value is not None}


_NOTHING = Node(None)


class Converter:
    """Converts the raw tables of a file, each once, and reports every error on the way instead of only the first."""

    def __init__(self, report: Report, more: More = NO_MORE, known: NodeCache | None = None) -> None:
        """Make a converter for one file.

        Args:
            report: called for every error.
            more: kinds from extensions.
            known: nodes of the files that are loaded together: a table that several files share is converted, and its errors reported, once.
        """
        self.report = report
        self._more = more
        self._known: NodeCache = {} if known is None else known

    def tree(self, raw: object, type_: Any, path: KeyPath = ()) -> Node:
        """Return the raw value as a node; a hole after at least one report.

        Args:
            raw: from the TOML parser.
            type_: a Struct, a union of Structs tagged by `kind`, a dict of names to either, or anything that msgspec converts.
            path: where `raw` stands.
        """
        if not isinstance(raw, dict):
            return self._value(raw, type_, path)
        key = (id(raw), id(type_))
        if key not in self._known:
            self._known[key] = self._value(raw, type_, path), raw, type_
        return self._known[key][0]

    def kind(self, raw: object, kinds: Mapping[str, Any], path: KeyPath) -> Node:
        """Return the table as the Struct that its `kind` names."""
        if not isinstance(raw, dict):
            return self._no_table(raw, path)
        if "kind" not in raw:
            known = {info.encode_name for struct in kinds.values() for info in fields(struct)}
            meant = next((key for key in raw if key not in known and _closest(key, ["kind"])), None)
            if meant is None:
                return self._hole(path, f'missing key "kind"; allowed: {", ".join(kinds) or "none"}')
            return self._hole(path, f'unknown key "{meant}" (did you mean "kind"?)', (*path, meant))
        kind = raw["kind"]
        if not isinstance(kind, str):
            text = f"expected a string, found {found(kind)}; allowed: {', '.join(kinds)}"
            return self._hole((*path, "kind"), text)
        if kind not in kinds:
            hint = translation(kind, kinds) or did_you_mean(kind, list(kinds))
            return self._hole((*path, "kind"), f'unknown kind "{kind}"{hint}; allowed: {", ".join(kinds) or "none"}')
        return self._struct(raw, kinds[kind], path, "kind")

    def _value(self, raw: object, type_: Any, path: KeyPath) -> Node:
        if type_ is Any:
            return Node(raw)
        members = _members(type_)
        if all(_is_struct(member) for member in members):
            if len(members) == 1 and members[0].__struct_config__.tag is None:
                return self._struct(raw, members[0], path)
            return self.kind(raw, kinds_of(Union[tuple(members)], self._more), path)  # noqa: UP007  # at run time
        if len(members) > 1:  # such as a number or an array of numbers: the raw value decides which is meant
            fitting = [member for member in members if _is_array(member) == isinstance(raw, (list, tuple))]
            return self._value(raw, fitting[0], path) if len(fitting) == 1 else self._leaf(raw, type_, path)
        (only,) = members
        if get_origin(_strip(only)) is dict:
            return self._names(raw, get_args(_strip(only))[1], path)
        if _is_array(only) and isinstance(raw, (list, tuple)):
            return self._array(raw, only, path)
        return self._leaf(raw, only, path)

    def _struct(self, raw: object, struct: Any, path: KeyPath, tag: str | None = None) -> Node:
        """Convert a table to a Struct; `tag` is the key that chose the Struct."""
        if not isinstance(raw, dict):
            return self._no_table(raw, path)
        infos = fields(struct)
        known = [info.encode_name for info in infos] + ([tag] if tag else [])
        unknown = [key for key in raw if key not in known]
        for key in unknown:
            self.report(path, f'unknown key "{key}"{translation(key, known) or suggestion(key, known)}', (*path, key))
        faulty = bool(unknown)
        meant = {_closest(key, known) for key in unknown}  # a misspelt key is one fault, not also a missing one
        values: dict[str, Any] = {}
        parts: dict[str, Node] = {}
        for info in infos:
            name = info.encode_name
            if name in raw:
                parts[name] = node = self.tree(raw[name], info.type, (*path, name))
                values[info.name] = node.value
                faulty |= node.value is None
            elif info.required:
                faulty = True
                if name not in meant:
                    only = get_args(info.type) if get_origin(info.type) is Literal else ()
                    write = f": write {name} = {_toml(only[0])}" if len(only) == 1 else ""
                    self.report(path, f'missing key "{name}"{write}')
            elif isinstance(info.default, msgspec.Struct):
                parts[name] = Node(info.default)
        if faulty:
            return Node(None, parts)
        try:
            return Node(struct(**values), parts)
        except (ValueError, TypeError) as error:  # from checks of the Struct itself
            return self._hole(path, str(error), parts=parts)

    def _names(self, raw: object, type_: Any, path: KeyPath) -> Node:
        if not isinstance(raw, dict):
            return self._no_table(raw, path)
        parts: dict[str, Node] = {}
        faulty = False
        for name, value in raw.items():
            parts[name] = self.tree(value, type_, (*path, name))
            named = type_ is Any or check_name((*path, name), self.report)
            faulty |= not named or parts[name].value is None
        return Node(None if faulty else {name: part.value for name, part in parts.items()}, parts)

    def _array(self, raw: Sequence[object], type_: Any, path: KeyPath) -> Node:
        arguments = get_args(_strip(type_))
        fixed = get_origin(_strip(type_)) is tuple and arguments[-1:] != (...,)
        if fixed and len(arguments) != len(raw):
            return self._hole(path, f"expected {expected(type_)}, found {found(raw)}")
        items = arguments if fixed else (arguments[0],) * len(raw)
        values = [self.tree(item, t, (*path, k)).value for k, (item, t) in enumerate(zip(raw, items, strict=True))]
        return _NOTHING if any(value is None for value in values) else self._leaf(values, type_, path)

    def _leaf(self, raw: object, type_: Any, path: KeyPath) -> Node:
        if isinstance(raw, float) and not math.isfinite(raw):
            return self._hole(path, f"expected {expected(type_)}, found {raw}: it must be finite")
        try:
            return Node(msgspec.convert(raw, type_, strict=True))
        except msgspec.ValidationError:
            text = f"expected {expected(type_)}, found {found(raw)}"
        if isinstance(raw, str) and get_origin(_strip(type_)) is Literal:
            values = [str(value) for value in get_args(_strip(type_))]
            text += translation(raw, values) or did_you_mean(raw, values)
        return self._hole(path, text)

    def _no_table(self, raw: object, path: KeyPath) -> Node:
        return self._hole(path, f"expected a table, found {found(raw)}")

    def _hole(self, path: KeyPath, text: str, at: KeyPath | None = None, parts: Mapping[str, Node] = {}) -> Node:
        self.report(path, text, at)
        return Node(None, parts)


NodeCache = dict[tuple[int, int], tuple[Node, object, Any]]
"""Nodes by the identities of the raw table and the type. Both are kept too: an identity is free for another object once its owner is gone."""


def convert(raw: object, type_: Any, path: KeyPath, report: Report, more: More = NO_MORE) -> Any:
    """Return the typed value alone, or None after at least one report; see `Converter`."""
    return Converter(report, more).tree(raw, type_, path).value


def check_name(path: KeyPath, report: Report) -> bool:
    """Return whether the last key can be one level of a path on every wire; report it otherwise."""
    name = str(path[-1])
    if NAME.fullmatch(name):
        return True
    report(
        path,
        f'"{name}" cannot be a name: begin with a letter or _, then use letters, digits, _ and - (it is part of a path)',
    )
    return False


def check_known(name: str, known: Sequence[str], noun: str, path: KeyPath, report: Report) -> None:
    """Report a name that is not among the known ones; `noun` says what it names."""
    if name not in known:
        report(path, f'no {noun} "{name}"{suggestion(name, known, "; there are: ")}')


def check_members(names: Sequence[str], known: Sequence[str], noun: str, path: KeyPath, report: Report) -> None:
    """Report those of a list of names that are not known or are repeated; `noun` says what one of them names."""
    for k, name in enumerate(names):
        check_known(name, known, noun, (*path, k), report)
        if name in names[:k]:
            report((*path, k), f'"{name}" is named twice')


def is_one_of(table: msgspec.Struct, keys: Sequence[str], path: KeyPath, report: Report) -> bool:
    """Return whether exactly one of two keys is given; report it otherwise."""
    given = [key for key in keys if getattr(table, key) is not msgspec.UNSET]
    if len(given) != 1:
        report(path, f"give exactly one of {' and '.join(keys)}: {'both are given' if given else 'none is given'}")
    return len(given) == 1


@cache
def fields(struct: Any) -> tuple[FieldInfo, ...]:
    """Return the fields of a Struct with resolved types."""
    return msgspec.structs.fields(struct)


def kinds_of(type_: Any, more: More = NO_MORE) -> dict[str, Any]:
    """Return the Structs of a tagged union by their `kind`."""
    members = _members(type_)
    kinds = {str(member.__struct_config__.tag): member for member in members}
    for base, further in more.items():
        if all(issubclass(member, base) for member in members):
            kinds |= further
    return kinds


def _members(type_: Any) -> tuple[Any, ...]:
    """Return those alternatives of a union that a TOML value can have."""
    alternatives = get_args(type_) if get_origin(type_) in (Union, UnionType) else (type_,)
    return tuple(member for member in alternatives if member not in (msgspec.UnsetType, type(None)))


def _closest(word: str, allowed: Sequence[str]) -> str | None:
    return word_here(word, allowed) or closest(word, allowed)


def _toml(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


def _strip(type_: Any) -> Any:
    return get_args(type_)[0] if get_origin(type_) is Annotated else type_


def _is_struct(type_: Any) -> bool:
    return isinstance(type_, type) and issubclass(type_, msgspec.Struct)


def _is_array(type_: Any) -> bool:
    return get_origin(_strip(type_)) in (tuple, list)
