"""The wire format of protobuf, as much of it as the messages of `codec` need (protobuf.dev/programming-guides/encoding).

Fields are written in the order of their numbers, and left out if they are zero or empty, as every encoder of proto3 does. So the bytes are those
of generated encoders.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

_DOUBLE = struct.Struct("<d")
_FIXED32 = struct.Struct("<I")
_ZERO = bytes(8)
_VARINT, _I64, _BYTES, _I32 = 0, 1, 2, 5


def varint(number: int) -> bytes:
    """Encode a number >= 0 with seven bits in each byte, the lowest first."""
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def _tag(field: int, kind: int) -> bytes:
    return varint(field << 3 | kind)


def double(field: int, value: float) -> bytes:
    """Encode a double; +0 as nothing."""
    data = _DOUBLE.pack(value)
    return b"" if data == _ZERO else _tag(field, _I64) + data


def whole(field: int, value: int) -> bytes:
    """Encode a bool, an enum, or an integer >= 0."""
    return _tag(field, _VARINT) + varint(value) if value else b""


def fixed32(field: int, value: int) -> bytes:
    """Encode an unsigned integer of four bytes."""
    return _tag(field, _I32) + _FIXED32.pack(value) if value else b""


def blob(field: int, data: bytes) -> bytes:
    """Encode bytes; no bytes as nothing."""
    return message(field, data) if data else b""


def text(field: int, value: str) -> bytes:
    """Encode a text in UTF-8. Half a surrogate pair becomes a question mark, because decoders refuse it."""
    return blob(field, value.encode("utf-8", "replace"))


def message(field: int, body: bytes) -> bytes:
    """Encode a message within a message, also an empty one."""
    return _tag(field, _BYTES) + varint(len(body)) + body


def doubles(field: int, values: Iterable[float] | npt.NDArray[np.float64]) -> bytes:
    """Encode a repeated double, packed."""
    return blob(field, np.fromiter(values, dtype="<f8").tobytes())


def words(field: int, values: npt.NDArray[np.uint32]) -> bytes:
    """Encode a repeated fixed32, packed."""
    return blob(field, values.astype("<u4").tobytes())
