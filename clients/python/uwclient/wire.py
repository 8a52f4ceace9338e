"""Reads typed values from decoded JSON or msgpack maps. Every fault is a ProtocolError that names the key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Union, cast

from uwclient.errors import ProtocolError

RequestId = Union[int, str]


def as_map(value: object, what: str) -> dict[str, object]:
    """Return `value` as a map. Raises ProtocolError if it is none."""
    if not isinstance(value, dict):
        raise ProtocolError(f"the server sent {_kind(value)} where {what} (a map) was expected", code="protocol")
    return cast("dict[str, object]", value)


def as_list(value: object, what: str) -> list[object]:
    """Return `value` as a list. Raises ProtocolError if it is none."""
    if not isinstance(value, (list, tuple)):
        raise ProtocolError(f"the server sent {_kind(value)} where {what} (a list) was expected", code="protocol")
    return list(cast("list[object]", value))


def text(source: Mapping[str, object], key: str, default: str | None = None) -> str:
    """Return the string at `key`. Without `default` it must be there."""
    value = source.get(key, default)
    if value is None and default is not None:
        return default
    if not isinstance(value, str):
        raise _wrong(key, value, "a string")
    return value


def integer(source: Mapping[str, object], key: str) -> int:
    """Return the integer at `key`."""
    value = source.get(key)
    if isinstance(value, bool) or not isinstance(value, int):
        raise _wrong(key, value, "an integer")
    return value


def number(source: Mapping[str, object], key: str) -> float | None:
    """Return the number at `key`, or None if it is absent, null or no single number."""
    value = source.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return float(value)


def flag(source: Mapping[str, object], key: str, default: bool = False) -> bool:
    """Return the boolean at `key`."""
    value = source.get(key, default)
    if not isinstance(value, bool):
        raise _wrong(key, value, "a boolean")
    return value


def request_id(source: Mapping[str, object], key: str = "id") -> RequestId | None:
    """Return the request id at `key`, or None for null."""
    value = source.get(key)
    if value is None or (isinstance(value, (int, str)) and not isinstance(value, bool)):
        return value
    raise _wrong(key, value, "an integer or a string")


def _wrong(key: str, value: object, expected: str) -> ProtocolError:
    return ProtocolError(f'the server sent {_kind(value)} as "{key}", expected {expected}', code="protocol", where=key)


def _kind(value: object) -> str:
    return "nothing" if value is None else f"a value of type {type(value).__name__}"
