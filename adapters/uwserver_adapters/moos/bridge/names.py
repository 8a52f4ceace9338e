"""Names of variables: ``<VEHICLE>_<COMPONENT>_<FIELD>``, upper case, with a last word for each component of a vector."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Literal

import msgspec

from uwserver.adapter import Undecodable, decode
from uwserver.ports import Buffer, Field, Port, Refused, Sample, Value

MOST_COMPONENTS = 16
"""Most components that become variables. A longer field is one JSON list whatever the scenario says: one sonar ping would make 300 variables."""

_encode = msgspec.json.Encoder().encode


def variable(*words: str) -> str:
    """Return the name of a port, a field or a component: in upper case, with "_" for all that is neither letter nor digit."""
    return re.sub(r"[^A-Za-z0-9]+", "_", "_".join(words)).strip("_").upper()


class Outlet:
    """Turns samples of one port into variables.

    Args:
        port: the port.
        vectors: how a vector is published, see `BridgeTable`.
        on_change: publish only values that have changed.
    """

    def __init__(self, port: Port, vectors: Literal["components", "json"], on_change: bool) -> None:
        self._on_change = on_change
        self._last: dict[str, float | str] = {}
        self._valid, self._was_valid = variable(port.path, "valid"), "true"
        self._names = [_names_of(port, field, vectors) for field in port.fields]

    def pairs(self, sample: Sample) -> list[tuple[str, float | str]]:
        """Return the variables of a sample. Those without a finite value are left out; ``..._VALID`` is published when it changes."""
        valid = "true" if sample.valid else "false"
        found: list[tuple[str, float | str | None]] = []
        for name, value in zip(self._names, sample.value, strict=False):
            if isinstance(name, str):
                found.append((name, _written(value)))
            elif isinstance(value, tuple):
                found += zip(name, map(_written, value), strict=False)
        pairs = [(name, value) for name, value in found if value is not None]
        if self._on_change:
            pairs = [(name, value) for name, value in pairs if self._last.get(name) != value]
            self._last.update(pairs)
        if self._was_valid != valid:
            pairs.insert(0, (self._valid, valid))
        self._was_valid = valid
        return pairs


def _names_of(port: Port, field: Field, vectors: Literal["components", "json"]) -> str | list[str]:
    """Return the name of a field, or the names of its components."""
    name = variable(port.path, field.name)
    if not field.shape or vectors == "json" or field.size > MOST_COMPONENTS:
        return name
    words: Iterable[object] = range(field.size)
    if field.is_rotation:
        words = "WXYZ"
    elif field.shape == (3,) and field.frame:
        words = "XYZ"
    return [f"{name}_{word}" for word in words]


def _written(value: Value) -> float | str | None:
    if isinstance(value, tuple):
        finite = [None if isinstance(part, float) and not math.isfinite(part) else part for part in value]
        return None if all(component is None for component in value) else _encode(finite).decode()
    if isinstance(value, Buffer):
        return _encode(value).decode()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return float(value) if math.isfinite(value) else None
    return value


def number(name: str, value: float | str) -> float:
    """Return the value of a variable that must be a number. Raises Refused where it is a text."""
    if isinstance(value, str):
        raise Refused("bad_argument", f'"{value[:40]}" is a text: write {name} as a number', name)
    return value


def given(value: float | str) -> object:
    """Return the field of a command: a number, or the JSON list in a text. Raises ValueError where the text is none."""
    if not isinstance(value, str):
        return value
    try:
        return decode(value.encode("utf-8", "replace"), "json")
    except Undecodable:
        raise ValueError(f'"{value[:40]}" is neither a number nor a JSON list') from None
