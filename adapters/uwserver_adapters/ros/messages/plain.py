"""Messages as maps, for JSON and CBOR: `plain` makes a map of a message, `built` makes a message of a client's map."""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from uwserver_adapters.ros.messages.types import (
    ARRAY,
    BASE,
    DTYPES,
    FILLER,
    NAME,
    SEQUENCE,
    BadMessage,
    Types,
    numeric_items,
)

_LIMITS = {
    name: (int(np.iinfo(dtype).min), int(np.iinfo(dtype).max))
    for name, dtype in DTYPES.items()
    if dtype != "bool" and not dtype.startswith("float")
}
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_OLD_NAMES = {"secs": "sec", "nsecs": "nanosec"}
LONGEST = 1 << 20
"""Most items of a list of messages or texts that a client may send."""


def plain(types: Types, message: Any) -> dict[str, Any]:
    """Return a map of a message's fields.

    Arrays of numbers stay numpy arrays, which each encoding writes in its own way. Times have ``secs`` and ``nsecs`` in ROS 1.
    """
    name = message.__msgtype__
    if name in _TIMES and types.is_ros1:
        return {"secs": message.sec, "nsecs": message.nanosec}
    return {
        field: _plain(types, described, getattr(message, field))
        for field, described in types.fields(name)
        if field != FILLER
    }


def _plain(types: Types, described: Any, value: Any) -> Any:
    kind, what = described
    if kind == NAME:
        return plain(types, value)
    if kind != BASE and what[0][0] == NAME:
        return [plain(types, item) for item in value]
    return value


def built(types: Types, name: str, given: object, where: str = "") -> Any:
    """Return a message made from a map.

    Missing fields are zero or empty. A whole number may come for a float, null for NaN, and base64 for bytes.

    Args:
        types: message types of the distribution.
        name: name of the message type.
        given: the map.
        where: path of this message in the outer one, for errors.

    Raises:
        BadMessage: a field is unknown or has a wrong value; the text names the field.
    """
    if not isinstance(given, Mapping):
        raise BadMessage(f"{where or name} must be a map, not {_word(given)}")
    if name in _TIMES:
        given = {_OLD_NAMES.get(str(key), key): value for key, value in given.items()}
    fields = dict(types.fields(name))
    for key in given:
        if not isinstance(key, str) or key not in fields:
            known = ", ".join(field for field in fields if field != FILLER) or "none"
            raise BadMessage(f"{where or name} has no field {str(key)[:60]!r}, it has: {known}")
    dot = f"{where}." if where else ""
    made = {str(key): _built(types, fields[str(key)], value, f"{dot}{key}") for key, value in given.items()}
    return types.make(name, **made)


def _built(types: Types, described: Any, value: Any, where: str) -> Any:
    kind, what = described
    if kind == NAME:
        return built(types, what, value, where)
    if kind == BASE:
        return _scalar(what[0], value, where)
    item, length = what
    dtype = numeric_items(described)
    if dtype is not None:
        made = _array(dtype, value, where)
    else:
        if not isinstance(value, list | tuple):
            raise BadMessage(f"{where} must be a list, not {_word(value)}")
        if len(value) > LONGEST:
            raise BadMessage(f"{where} has {len(value)} items, at most {LONGEST} are taken")
        made = [_built(types, item, entry, f"{where}[{k}]") for k, entry in enumerate(value)]
    if kind == ARRAY and len(made) != length:
        raise BadMessage(f"{where} must have {length} items, not {len(made)}")
    if kind == SEQUENCE and length and len(made) > length:
        raise BadMessage(f"{where} has {len(made)} items, at most {length} are taken")
    return made


def _scalar(kind: str, value: Any, where: str) -> Any:
    if kind == "string":
        if not isinstance(value, str):
            raise BadMessage(f"{where} must be a text, not {_word(value)}")
        return value
    if kind == "bool":
        if value is True or value is False or (isinstance(value, int) and value in (0, 1)):
            return bool(value)
        raise BadMessage(f"{where} must be true or false, not {_word(value)}")
    if kind.startswith("float"):
        if value is None:
            return math.nan
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadMessage(f"{where} must be a number, not {_word(value)}")
        # Python compares a whole number of any size with a float exactly.
        if abs(value) > float(np.finfo(DTYPES[kind]).max) and value not in (math.inf, -math.inf):
            raise BadMessage(f"{where} is too large for {kind}")
        return float(value)
    # `math.isfinite` fails on whole numbers that no float can hold.
    is_endless = isinstance(value, float) and not math.isfinite(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or is_endless:
        raise BadMessage(f"{where} must be a whole number, not {_word(value)}")
    low, high = _LIMITS[kind]
    if value != int(value) or not low <= value <= high:
        raise BadMessage(f"{where} must be a whole number from {low} to {high}, not {value!r:.40}")
    return int(value)


def _array(dtype: str, value: Any, where: str) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, bytes) and dtype == "uint8":
        return np.frombuffer(value, np.uint8)
    if isinstance(value, str) and dtype == "uint8":
        try:
            return np.frombuffer(base64.b64decode(value, validate=True), np.uint8)
        except (binascii.Error, ValueError):
            raise BadMessage(f"{where} is no base64") from None
    if not isinstance(value, list | tuple):
        raise BadMessage(f"{where} must be a list, not {_word(value)}")
    if dtype == "float64" and all(type(part) is float for part in value):  # the usual case, without a check of each
        return np.array(value, np.float64)
    return np.array([_scalar(dtype, part, f"{where}[{k}]") for k, part in enumerate(value)], dtype)


def _word(value: object) -> str:
    words = {type(None): "null", bool: "a boolean", str: "a text", int: "a number", float: "a number", list: "a list"}
    return words.get(type(value), "a map" if isinstance(value, Mapping) else f"a {type(value).__name__}")
