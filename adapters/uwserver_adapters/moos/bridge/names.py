"""Names of variables: ``<VEHICLE>_<COMPONENT>_<FIELD>``, upper case, with a last word for each component of a vector."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Literal

import msgspec

from uwserver.adapter import Undecodable, decode
from uwserver.ports import Buffer, Field, Port, Refused, Sample, Scalar, Value

MOST_COMPONENTS = 16
"""A longer field is one JSON list whatever the scenario says: nobody wants 300 variables of one sonar ping."""

_encode = msgspec.json.Encoder().encode


def variable(*words: str) -> str:
    """The name of a port, a field or a component: upper case, "_" for all that is neither letter nor digit."""
    return re.sub(r"[^A-Za-z0-9]+", "_", "_".join(words)).strip("_").upper()


class Outlet:
    """Turns samples of one port into variables.

    Attributes:
        port: as given.
    """

    def __init__(self, port: Port, vectors: Literal["components", "json"], on_change: bool) -> None:
        self.port = port
        self._on_change = on_change
        self._last: dict[str, float | str] = {}
        self._valid = variable(port.path, "valid")
        self._names = [self._of(field, vectors) for field in port.fields]

    def _of(self, field: Field, vectors: Literal["components", "json"]) -> str | list[str]:
        """One name, or one of each component."""
        name = variable(self.port.path, field.name)
        if not field.shape or vectors == "json" or field.size > MOST_COMPONENTS:
            return name
        if field.is_rotation:
            words: Iterator[str] | tuple[str, ...] = ("W", "X", "Y", "Z")
        elif field.shape == (3,) and field.frame:
            words = ("X", "Y", "Z")
        else:
            words = map(str, range(field.size))
        return [f"{name}_{word}" for word in words]

    def pairs(self, sample: Sample) -> list[tuple[str, float | str]]:
        """Variables of a sample. What has no value, or no finite one, is left out; ``..._VALID`` is published when it changes."""
        pairs: list[tuple[str, float | str]] = []
        valid = "true" if sample.valid else "false"
        if self._last.get(self._valid, "true") != valid:
            pairs.append((self._valid, valid))
        self._last[self._valid] = valid
        for name, value in zip(self._names, sample.value, strict=False):
            if isinstance(name, str):
                self._add(pairs, name, _written(value))
            elif isinstance(value, tuple):
                for word, component in zip(name, value, strict=False):
                    self._add(pairs, word, _written(component))
        return pairs

    def _add(self, pairs: list[tuple[str, float | str]], name: str, value: float | str | None) -> None:
        if value is None or (self._on_change and self._last.get(name) == value):
            return
        if self._on_change:
            self._last[name] = value
        pairs.append((name, value))


def _written(value: Value) -> float | str | None:
    if isinstance(value, tuple):
        return None if all(component is None for component in value) else _encode(_finite(value)).decode()
    if isinstance(value, Buffer):
        return _encode(value).decode()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return float(value) if math.isfinite(value) else None
    return value


def _finite(value: tuple[Scalar, ...]) -> list[Scalar]:
    return [None if isinstance(part, float) and not math.isfinite(part) else part for part in value]


def number(name: str, value: float | str) -> float:
    """Of a variable that is to be one; Refused for a text."""
    if isinstance(value, str):
        raise Refused("bad_argument", f'"{value[:40]}" is a text: write {name} as a number', name)
    return value


def given(value: float | str) -> object:
    """A field of a command: a number, or a JSON list in a text."""
    if not isinstance(value, str):
        return value
    try:
        return decode(value.encode("utf-8", "replace"), "json")
    except Undecodable:
        raise ValueError(f'"{value[:40]}" is neither a number nor a JSON list') from None
