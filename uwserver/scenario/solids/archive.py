"""Solid things as one line of text, for a recording: what was read from mesh and grid files must not depend on those files later."""

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
"""No archive that is unpacked may be larger."""


def pack(solids: Mapping[str, Solid]) -> str:
    """Solids by name, compressed; `unpack` gives the same bits."""
    plain = {name: _solid_to(solid) for name, solid in solids.items()}
    packed = msgspec.msgpack.encode(plain)
    return base64.b85encode(zstandard.ZstdCompressor().compress(packed)).decode()


def unpack(text: str) -> dict[str, Solid]:
    """The solids of `pack`.

    Raises:
        ValueError: the text is none of `pack`'s.
    """
    try:
        compressed = base64.b85decode(text)
        if (
            zstandard.frame_content_size(compressed) > LARGEST_BYTES
        ):  # where it is told, the decompressor knows no limit
            raise ValueError(f"the solid things have more than {LARGEST_BYTES} bytes")
        packed = zstandard.ZstdDecompressor().decompress(compressed, max_output_size=LARGEST_BYTES)
        plain = msgspec.msgpack.decode(packed)
        return {name: _solid_from(table) for name, table in plain.items()}
    except (zstandard.ZstdError, msgspec.MsgspecError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"the solid things cannot be read: {error}") from error


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
    made: Shape = kind(**values)
    return made
