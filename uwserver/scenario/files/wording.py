"""Describes types and values in words, for error texts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec.inspect as mi
from msgspec import Struct

from uwserver.logs import place_of
from uwserver.scenario.files.documents import label_of


def expected(type_: Any) -> str:
    """Describe what a value of this type looks like in a file, limits included: ``a number greater than 0``."""
    return _expected(mi.type_info(type_))


def found(raw: object) -> str:
    """Describe the value that the file has instead: ``the string "abc"``."""
    if isinstance(raw, bool):
        return f"the boolean {str(raw).lower()}"
    if isinstance(raw, str):
        return f'the string "{raw if len(raw) <= 40 else raw[:37] + "..."}"'
    if isinstance(raw, (list, tuple)):
        return f"an array of {len(raw)}"
    if isinstance(raw, dict):
        return "a table"
    return number(raw) if isinstance(raw, (int, float)) else f"a {type(raw).__name__}"


def number(raw: float) -> str:
    """Write a number; of a very long integer only its length."""
    if isinstance(raw, int):
        return str(raw) if abs(raw) < 10**20 else f"an integer of {raw.bit_length()} bits"
    return repr(raw)


def not_built(table: Struct, error: Exception) -> str:
    """Say why an extension's code could not build what a table declares, with the file and line of the failure."""
    file, line = place_of(error)
    where, kind = f"{label_of(Path(file))}:{line}", table.__struct_config__.tag
    return f'a component of kind "{kind}" cannot be built ({where}): {type(error).__name__}: {error}'


def _expected(node: mi.Type) -> str:
    if isinstance(node, mi.Metadata):
        return _expected(node.type)
    if isinstance(node, mi.FloatType):
        return "a number" + _limits(node)
    if isinstance(node, mi.IntType):
        return "a whole number" + _limits(node)
    if isinstance(node, mi.BoolType):
        return "true or false"
    if isinstance(node, mi.StrType):
        return "a string that is not empty" if node.min_length else "a string"
    if isinstance(node, mi.LiteralType):
        values = [f'"{value}"' if isinstance(value, str) else str(value) for value in node.values]
        return values[0] if len(values) == 1 else "one of " + ", ".join(values)
    if isinstance(node, mi.TupleType):
        return f"an array of {len(node.item_types)} ({_expected(node.item_types[0])} each)"
    if isinstance(node, (mi.VarTupleType, mi.ListType)):
        least = f" of at least {node.min_length}" if node.min_length else ""
        return f"an array{least} ({_expected(node.item_type)} each)"
    if isinstance(node, mi.UnionType):
        return " or ".join(_expected(member) for member in node.types if not isinstance(member, mi.NoneType))
    return "a table"


def _limits(node: mi.FloatType | mi.IntType) -> str:
    if node.ge is not None and node.le is not None:
        return f" from {node.ge:g} to {node.le:g}"
    words = {"gt": "greater than", "ge": "of at least", "lt": "less than", "le": "of at most"}
    limits = [f"{text} {limit:g}" for key, text in words.items() if (limit := getattr(node, key)) is not None]
    return " " + " and ".join(limits) if limits else ""
