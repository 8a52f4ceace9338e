"""From raw TOML tables to typed tables, telling every fault on the way instead of only the first."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, Protocol, Union, get_args, get_origin

import msgspec
from msgspec.structs import FieldInfo

from uwserver.scenario.files.errors import KeyPath, closest, did_you_mean, suggestion
from uwserver.scenario.files.wording import expected, found

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
"""What a table name must look like: it becomes a level of a path on every wire."""


class Report(Protocol):
    """Takes in one fault of the value at `path`; `at` is the key to point at where that is another one."""

    def __call__(self, path: KeyPath, text: str, at: KeyPath | None = None) -> None: ...


def silent(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
    """A `Report` for a second look at what has been reported already."""


More = Mapping[type, Mapping[str, Any]]
"""Kinds beside those of a union: for all unions whose members derive from a base, Structs by their `kind`."""
NO_MORE: More = {}


def convert(raw: object, type_: Any, path: KeyPath, report: Report, more: More = NO_MORE) -> Any:
    """The typed value, or None after at least one report.

    Args:
        raw: what the TOML parser gave.
        type_: a Struct, a union of Structs tagged by `kind`, a dict of names to either, or anything that msgspec converts.
        path: where `raw` stands.
        report: gets every fault.
        more: kinds of an extension.
    """
    if type_ is Any:
        return raw
    members = _members(type_)
    if all(_is_struct(member) for member in members):
        return _convert_table(raw, members, path, report, more)
    if len(members) > 1:  # numbers or arrays of them: what stands there says which is meant
        fitting = [member for member in members if _is_array(member) == isinstance(raw, (list, tuple))]
        if len(fitting) == 1:
            return convert(raw, fitting[0], path, report, more)
        return _leaf(raw, type_, path, report)
    (only,) = members
    if get_origin(_strip(only)) is dict:
        return _convert_names(raw, get_args(_strip(only))[1], path, report, more)
    if _is_array(only) and isinstance(raw, (list, tuple)):
        return _convert_array(raw, only, path, report, more)
    return _leaf(raw, only, path, report)


def convert_kind(raw: object, kinds: Mapping[str, Any], path: KeyPath, report: Report, more: More = NO_MORE) -> Any:
    """The typed table of the Struct that the table's `kind` names, or None after at least one report."""
    if not isinstance(raw, dict):
        return report(path, f"expected a table, found {found(raw)}")
    if "kind" not in raw:
        known = {info.encode_name for struct in kinds.values() for info in fields(struct)}
        meant = next((key for key in raw if key not in known and closest(key, ["kind"])), None)
        if meant is None:
            return report(path, f'missing key "kind"; allowed: {", ".join(kinds) or "none"}')
        return report(path, f'unknown key "{meant}" (did you mean "kind"?)', (*path, meant))
    kind = raw["kind"]
    if not isinstance(kind, str):
        return report((*path, "kind"), f"expected a string, found {found(kind)}; allowed: {', '.join(kinds)}")
    if kind not in kinds:
        hint = did_you_mean(kind, list(kinds))
        return report((*path, "kind"), f'unknown kind "{kind}"{hint}; allowed: {", ".join(kinds) or "none"}')
    return convert_struct(raw, kinds[kind], path, report, "kind", more)


def convert_struct(
    raw: object, struct: Any, path: KeyPath, report: Report, tag: str | None = None, more: More = NO_MORE
) -> Any:
    """The Struct, or None after at least one report; `tag` is the key that chose the Struct."""
    if not isinstance(raw, dict):
        return report(path, f"expected a table, found {found(raw)}")
    infos = fields(struct)
    known = [info.encode_name for info in infos] + ([tag] if tag else [])
    unknown = [key for key in raw if key not in known]
    for key in unknown:
        report(path, f'unknown key "{key}"{suggestion(key, known)}', (*path, key))
    faulty = bool(unknown)
    meant = {closest(key, known) for key in unknown}  # a misspelt key is one fault, not also a missing one
    values: dict[str, Any] = {}
    for info in infos:
        if info.encode_name in raw:
            values[info.name] = convert(raw[info.encode_name], info.type, (*path, info.encode_name), report, more)
            faulty |= values[info.name] is None
        elif info.required:
            faulty = True
            if info.encode_name not in meant:
                report(path, f'missing key "{info.encode_name}"')
    if faulty:
        return None
    try:
        return struct(**values)
    except (ValueError, TypeError) as error:  # what a Struct checks by itself
        return report(path, str(error))


def check_name(path: KeyPath, report: Report) -> bool:
    """Whether the last key can be a level of a path on every wire; reports it otherwise."""
    name = str(path[-1])
    if NAME.fullmatch(name):
        return True
    report(
        path,
        f'"{name}" cannot be a name: begin with a letter or _, go on with letters, digits, _ and - (it is part of a path)',
    )
    return False


@cache
def fields(struct: Any) -> tuple[FieldInfo, ...]:
    """Fields of a Struct with resolved types."""
    return msgspec.structs.fields(struct)


def kinds_of(type_: Any, more: More = NO_MORE) -> dict[str, Any]:
    """Structs of a tagged union by their `kind`."""
    members = _members(type_)
    kinds = {str(member.__struct_config__.tag): member for member in members}
    for base, further in more.items():
        if all(issubclass(member, base) for member in members):
            kinds |= further
    return kinds


def _convert_table(raw: object, members: Sequence[Any], path: KeyPath, report: Report, more: More) -> Any:
    if len(members) == 1 and members[0].__struct_config__.tag is None:
        return convert_struct(raw, members[0], path, report, None, more)
    return convert_kind(raw, kinds_of(Union[tuple(members)], more), path, report, more)  # noqa: UP007  # at run time


def _convert_names(raw: object, type_: Any, path: KeyPath, report: Report, more: More) -> Any:
    if not isinstance(raw, dict):
        return report(path, f"expected a table, found {found(raw)}")
    values: dict[str, Any] = {}
    for name, value in raw.items():
        values[name] = convert(value, type_, (*path, name), report, more)
        if type_ is not Any and not check_name((*path, name), report):
            values[name] = None
    return None if any(value is None for value in values.values()) else values


def _convert_array(raw: Sequence[object], type_: Any, path: KeyPath, report: Report, more: More) -> Any:
    arguments = get_args(_strip(type_))
    fixed = get_origin(_strip(type_)) is tuple and arguments[-1:] != (...,)
    if fixed and len(arguments) != len(raw):
        return report(path, f"expected {expected(type_)}, found {found(raw)}")
    items = arguments if fixed else (arguments[0],) * len(raw)
    values = [convert(item, t, (*path, k), report, more) for k, (item, t) in enumerate(zip(raw, items, strict=True))]
    return None if any(value is None for value in values) else _leaf(values, type_, path, report)


def _leaf(raw: object, type_: Any, path: KeyPath, report: Report) -> Any:
    if isinstance(raw, float) and not math.isfinite(raw):
        return report(path, f"expected {expected(type_)}, found {raw}: it must be finite")
    try:
        return msgspec.convert(raw, type_, strict=True)
    except msgspec.ValidationError:
        text = f"expected {expected(type_)}, found {found(raw)}"
    if isinstance(raw, str) and get_origin(_strip(type_)) is Literal:
        text += did_you_mean(raw, [str(value) for value in get_args(_strip(type_))])
    return report(path, text)


def _members(type_: Any) -> tuple[Any, ...]:
    """Alternatives of a union that a TOML value can stand for."""
    alternatives = get_args(type_) if get_origin(type_) in (Union, UnionType) else (type_,)
    return tuple(member for member in alternatives if member not in (msgspec.UnsetType, type(None)))


def _strip(type_: Any) -> Any:
    return get_args(type_)[0] if get_origin(type_) is Annotated else type_


def _is_struct(type_: Any) -> bool:
    return isinstance(type_, type) and issubclass(type_, msgspec.Struct)


def _is_array(type_: Any) -> bool:
    return get_origin(_strip(type_)) in (tuple, list)
