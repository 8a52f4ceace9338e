"""Packs solids into one line of text, so that a recording does not depend on the mesh and grid files later."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_args

import msgspec
import numpy as np
import zstandard

from uwserver.physics.geometry.shapes import Placed, Shape, Solid

_KINDS: Mapping[str, type[Any]] = {kind.__name__: kind for kind in get_args(Shape)}
LARGEST_BYTES = 1 << 30
"""Largest size of an archive after it is unpacked."""


def pack(solids: Mapping[str, Solid]) -> str:
    """Pack solids by name; `unpack` returns them bit for bit."""
    return compressed({name: _solid_to(solid) for name, solid in solids.items()})


def unpack(text: str) -> dict[str, Solid]:
    """Return the solids that `pack` packed.

    Raises:
        ValueError: the text does not come from `pack`.
    """
    try:
        plain = msgspec.msgpack.decode(decompressed(text))
        return {name: _solid_from(table) for name, table in plain.items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:  # msgspec's errors are ValueErrors
        raise ValueError(f"the solids cannot be read: {error}") from error


def compressed(plain: object) -> str:
    """Return a value as MessagePack, compressed, in one line of text."""
    return base64.b85encode(zstandard.ZstdCompressor().compress(msgspec.msgpack.encode(plain))).decode()


def decompressed(text: str) -> bytes:
    """Return the MessagePack of a text from `compressed`.

    Raises:
        ValueError: the text does not come from there, or unpacks to more than `LARGEST_BYTES`.
    """
    data = base64.b85decode(text)
    try:
        # Where the frame gives its size, the decompressor ignores max_output_size.
        if zstandard.frame_content_size(data) > LARGEST_BYTES:
            raise ValueError(f"they have more than {LARGEST_BYTES} bytes")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=LARGEST_BYTES)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error


def _solid_to(solid: Solid) -> dict[str, Any]:
    placed = [
        {**vars(each), "kind": type(each.shape).__name__, "shape": _shape_to(each.shape)} for each in solid.shapes
    ]
    return {**vars(solid), "shapes": placed}


def _shape_to(shape: Shape) -> dict[str, Any]:
    return {
        name: [value.dtype.str, value.shape, value.tobytes()] if isinstance(value, np.ndarray) else value
        for name, value in vars(shape).items()
    }


def _solid_from(table: dict[str, Any]) -> Solid:
    placed = tuple(
        Placed(_shape_from(_KINDS[each["kind"]], each["shape"]), tuple(each["p"]), tuple(each["q"]), each["material"])
        for each in table["shapes"]
    )
    return Solid(table["name"], placed, table["friction"], table["restitution"], table["material"])


def _shape_from(kind: type[Any], table: dict[str, Any]) -> Shape:
    values: dict[str, Any] = {}
    for field in fields(kind):
        value = table[field.name]
        if isinstance(value, list) and len(value) == 3 and isinstance(value[0], str):
            dtype, shape, data = value
            value = np.frombuffer(data, np.dtype(dtype)).reshape(shape)
        values[field.name] = tuple(value) if isinstance(value, list) else value
    return kind(**values)  # type: ignore[no-any-return]  # a Shape
