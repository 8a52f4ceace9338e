"""What an array of a sensor looks like on a screen, and PNG of that. This module imports no other part of uwserver."""

from __future__ import annotations

import struct
import zlib
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]
"""``[h, w, 3]`` RGB or ``[h, w]`` grey, contiguous."""

MOST_PIXELS = 1 << 24
"""Most pixels of a picture that is shown, 4096 x 4096."""
FAR_MM = 20_000
"""Distance from which on pixels are black; nearer ones are brighter."""
_IDS = 256
"""Numbers of objects are below this. A picture of distances has larger numbers."""
_KINDS = {1: 0, 3: 2, 4: 6}
"""Colour type of a PNG by the number of channels."""


def pixels_of(array: NDArray[Any]) -> Pixels | None:
    """Return what an array looks like on a screen, or None if it is no picture, is empty, or has more than `MOST_PIXELS`.

    Distances become grey: the nearer the brighter, and black from `FAR_MM` on and where there is nothing. Each number of an object has a
    colour.
    """
    shape = array.shape
    if len(shape) not in (2, 3) or not 0 < shape[0] * shape[1] <= MOST_PIXELS:
        return None
    if array.dtype == np.uint8 and (len(shape) == 2 or shape[2] == 3):
        return array
    if array.dtype == np.uint16 and len(shape) == 2:
        return np.ascontiguousarray(_colours()[array]) if int(array.max()) < _IDS else _brightness()[array]
    return None


@cache
def _colours() -> Pixels:
    """Return a colour for each number of an object: very different ones for successive numbers, black for 0."""
    hue = (np.arange(_IDS) * 0.618034) % 1.0
    channels = np.abs((hue[:, None] + np.array([0.0, 2 / 3, 1 / 3])) % 1.0 * 6.0 - 3.0) - 1.0
    table: Pixels = (64 + 191 * np.clip(channels, 0.0, 1.0)).astype(np.uint8)
    table[0] = 0
    return table


@cache
def _brightness() -> Pixels:
    """Return the grey level of each distance in mm."""
    grey: Pixels = (255 - np.arange(1 << 16) * 255 // FAR_MM).clip(0, 255).astype(np.uint8)
    grey[0] = 0
    return grey


def png(pixels: NDArray[np.uint8], palette: bytes = b"") -> bytes:
    """Return a PNG.

    Args:
        pixels: (rows, columns) grey, (rows, columns, 3) RGB, (rows, columns, 4) RGBA, or (rows, columns) indices into a palette.
        palette: 256 times red, green, blue.
    """
    rows, columns = pixels.shape[:2]
    lines = np.zeros((rows, 1 + pixels[0].size), dtype=np.uint8)
    lines[:, 1:] = pixels.reshape(rows, -1)
    kind = 3 if palette else _KINDS[1 if pixels.ndim == 2 else pixels.shape[2]]

    def part(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    parts = [part(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, kind, 0, 0, 0))]
    if palette:
        parts.append(part(b"PLTE", palette))
    parts += [part(b"IDAT", zlib.compress(lines.tobytes(), 9)), part(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
