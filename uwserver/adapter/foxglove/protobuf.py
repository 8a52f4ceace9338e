"""The wire form of protobuf, as much of it as the messages of `messages` need (protobuf.dev/programming-guides/encoding).

Fields are written in the order of their numbers and left out where they are zero or empty, as every encoder of proto3 does: the bytes are those
of the generated ones.
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
    """A number >= 0, seven bits a byte, the lowest first."""
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def _tag(field: int, kind: int) -> bytes:
    return varint(field << 3 | kind)


def double(field: int, value: float) -> bytes:
    """A double; nothing for +0."""
    data = _DOUBLE.pack(value)
    return b"" if data == _ZERO else _tag(field, _I64) + data


def whole(field: int, value: int) -> bytes:
    """A bool, an enum, or an integer >= 0."""
    return _tag(field, _VARINT) + varint(value) if value else b""


def fixed32(field: int, value: int) -> bytes:
    """An unsigned integer of four bytes."""
    return _tag(field, _I32) + _FIXED32.pack(value) if value else b""


def blob(field: int, data: bytes) -> bytes:
    """Bytes; nothing for none."""
    return message(field, data) if data else b""


def text(field: int, value: str) -> bytes:
    """UTF-8; half a surrogate pair becomes a question mark, for decoders refuse it."""
    return blob(field, value.encode("utf-8", "replace"))


def message(field: int, body: bytes) -> bytes:
    """A message within a message, also an empty one."""
    return _tag(field, _BYTES) + varint(len(body)) + body


def doubles(field: int, values: Iterable[float] | npt.NDArray[np.float64]) -> bytes:
    """A repeated double, packed."""
    return blob(
        field, np.asarray(list(values) if not isinstance(values, np.ndarray) else values, dtype="<f8").tobytes()
    )


def words(field: int, values: npt.NDArray[np.uint32]) -> bytes:
    """A repeated fixed32, packed."""
    return blob(field, values.astype("<u4").tobytes())
