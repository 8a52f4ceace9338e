"""Buffers: images, rows of echoes or payloads as bytes with a type and a shape.

A buffer has one form for each kind of wire (docs/reference/protocol.md): base64 in texts, bytes in binary encodings. This module imports only
what makes pictures of them.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from typing import Any, Literal

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from uwserver.ports.pictures import pixels_of, png

Dtype = Literal["uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64"]
"""Type of an item, little-endian."""
ITEM_BYTES: dict[Dtype, int] = {
    "uint8": 1, "int8": 1, "uint16": 2, "int16": 2, "uint32": 4, "int32": 4, "float32": 4, "float64": 8,
}  # fmt: skip
MOST_DIMENSIONS = 4
LARGEST = 1 << 20
"""Largest buffer in a command, bytes, if its field gives no lower limit: a decoder copies it in one step."""


class Buffer(
    Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True, rename={"data": "base64"}
):
    """An immutable array as bytes in row-major order, little-endian; or plain bytes without type and shape.

    JSON encoders write it as ``{"dtype": "uint8", "shape": [2, 3], "base64": "..."}``, and plain bytes as ``{"base64": "..."}``.

    Attributes:
        dtype: type of an item; "" for plain bytes.
        shape: up to four extents.
        data: exactly as many bytes as type and shape need.

    Raises:
        ValueError: dtype, shape and data do not fit each other (`TypeError` if data is not bytes).
    """

    dtype: Dtype | Literal[""] = ""
    shape: tuple[int, ...] = ()
    data: bytes

    def __post_init__(self) -> None:
        if not isinstance(self.data, bytes):
            raise TypeError(f"the data of a buffer must be bytes, not {type(self.data).__name__}")
        if not self.dtype and not self.shape:
            return
        if self.dtype not in ITEM_BYTES:
            raise ValueError(f"no dtype {str(self.dtype)[:40]!r}; there are: {', '.join(ITEM_BYTES)}")
        if len(self.shape) > MOST_DIMENSIONS or not all(type(n) is int and 0 <= n < 1 << 32 for n in self.shape):
            raise ValueError(f"a shape must be a list of at most {MOST_DIMENSIONS} whole numbers from 0 to 4294967295")
        wanted = math.prod(self.shape) * ITEM_BYTES[self.dtype]
        if wanted != len(self.data):
            raise ValueError(
                f"{self.dtype} of shape {list(self.shape)} needs {wanted} bytes, but there are {len(self.data)}"
            )
        if math.prod(n or 1 for n in self.shape) > 1 << 40:  # numpy makes no array of such a shape, even if it is empty
            raise ValueError(f"a shape of {list(self.shape)} is too large")

    @classmethod
    def of(cls, array: NDArray[Any]) -> Buffer:
        """Return a buffer with a copy of an array.

        Raises:
            ValueError: the array has a type that `Dtype` does not name, or more than four dimensions.
        """
        name: Any = array.dtype.name
        if name not in ITEM_BYTES:
            raise ValueError(f"no buffer of {name}: convert the array to one of {', '.join(ITEM_BYTES)}")
        return cls(dtype=name, shape=array.shape, data=array.astype(_numpy(name), copy=False).tobytes())

    def array(self) -> NDArray[Any]:
        """Return the items in their shape, as a read-only view of the bytes. Plain bytes are uint8 with one dimension."""
        if not self.dtype:
            return np.frombuffer(self.data, np.uint8)
        return np.frombuffer(self.data, _numpy(self.dtype)).reshape(self.shape)

    def is_finite(self) -> bool:
        """Return whether every item is a finite number."""
        return not self.dtype.startswith("float") or bool(np.isfinite(self.array()).all())

    def _repr_png_(self) -> bytes | None:
        """Show a picture in a notebook."""
        shown = pixels_of(self.array())
        return None if shown is None else png(shown)

    def __repr__(self) -> str:
        """Return a short text for logs that differs for different bytes."""
        digest = hashlib.blake2b(self.data, digest_size=8).hexdigest()
        return f"Buffer({self.dtype or 'bytes'} {list(self.shape)}, {len(self.data)} bytes, {digest})"


def _numpy(dtype: Dtype) -> np.dtype[Any]:
    return np.dtype(dtype).newbyteorder("<")


class Layout(Struct, frozen=True):
    """Type and shape of the buffers of a field; an extent of -1 varies."""

    dtype: Dtype
    shape: tuple[int, ...]

    def __str__(self) -> str:
        """Return it as people write it: ``uint8 nx512``."""
        return f"{self.dtype} {'x'.join('n' if extent < 0 else str(extent) for extent in self.shape) or 'scalar'}"

    def fits(self, buffer: Buffer) -> bool:
        """Return whether a buffer has this type and a shape that this one allows."""
        alike = self.dtype == buffer.dtype and len(buffer.shape) == len(self.shape)
        return alike and all(m in (-1, n) for m, n in zip(self.shape, buffer.shape, strict=True))

    def shaped(self, data: bytes) -> Buffer:
        """Return plain bytes as a buffer, if the shape follows from their number.

        Raises:
            ValueError: the shape does not follow.
        """
        row = math.prod(n for n in self.shape if n >= 0) * ITEM_BYTES[self.dtype]
        free = self.shape.count(-1)
        if free > 1 or (free and not row):
            raise ValueError("its shape does not follow from the number of bytes: send a buffer with dtype and shape")
        rows = len(data) // row if free else 0
        return Buffer(dtype=self.dtype, shape=tuple(rows if n < 0 else n for n in self.shape), data=data)


def binary_form(value: object) -> object:
    """Return a value for msgpack: a buffer as ``{"dtype", "shape", "data"}``, plain bytes as bytes, anything else unchanged."""
    if isinstance(value, Buffer):
        return {"dtype": value.dtype, "shape": value.shape, "data": value.data} if value.dtype else value.data
    return value


def unpacked(packed: Mapping[str, object]) -> Buffer:
    """Return the buffer that a map from a text or binary wire describes.

    Raises:
        ValueError: the map is not a buffer; the text says why.
    """
    if isinstance(packed.get("data"), bytes) and "base64" not in packed:
        packed = {"base64" if key == "data" else key: entry for key, entry in packed.items()}
    return msgspec.convert(packed, Buffer)
