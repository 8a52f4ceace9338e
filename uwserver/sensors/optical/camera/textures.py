"""Textures, the pictures on triangles. One array holds them with coarser copies of each, so that distant things do not flicker."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from uwserver.packages import install_command

MOST_PIXELS = 4096 * 4096
"""Most pixels of one picture."""
MOST_BYTES = 256 << 20
"""Most bytes of all pictures of a world."""

LEVEL = np.dtype([("first", "i8"), ("width", "i8"), ("height", "i8"), ("levels", "i8")])
"""A picture or a coarser copy: its first texel, its size, and how many coarser copies follow, each half as large."""

Picture = npt.NDArray[np.uint8]
"""(h, w, 3) sRGB."""


class BadTexture(ValueError):
    """A picture that cannot be used. The text says why and what to do."""


class ByteBudget:
    """Bytes that pictures may still take. Pictures that fail to decode count too, so that bad pictures cost no more than good ones."""

    def __init__(self, left: int = MOST_BYTES) -> None:
        """left: bytes for the pictures of all things of a world."""
        self.left = left

    def take(self, size: int) -> None:
        """Take bytes, or raise BadTexture if there are not enough."""
        if size > self.left:
            raise BadTexture(f"the textures of all things have more than {MOST_BYTES >> 20} MB: make them smaller")
        self.left -= size


def decoded(data: bytes, budget: ByteBudget) -> Picture:
    """Return the pixels of a PNG or JPEG file. The size is checked before they are decoded.

    Raises:
        BadTexture: the file is no such picture or too large, there is no budget left, or the library that reads it is not installed.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise BadTexture(f'textures need the extra "pictures": {install_command("uwserver[pictures]")}') from error
    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as picture:
            width, height = picture.size
            if width * height > MOST_PIXELS:
                raise BadTexture(f"a texture of {width} x {height} pixels: at most {MOST_PIXELS}, make it smaller")
            budget.take(3 * width * height)
            return np.asarray(picture.convert("RGB"), np.uint8)
    except BadTexture:
        raise
    except Exception as error:  # a parser of foreign files may raise anything
        raise BadTexture(f"a texture that is no PNG or JPEG: {type(error).__name__}: {error}") from error


class Atlas:
    """All textures of a world.

    Attributes:
        levels: LEVEL (n). The number of a texture is that of its finest level.
        texels: (m, 3) sRGB.
    """

    def __init__(self, pictures: Sequence[Picture] = ()) -> None:
        """Raises BadTexture if there are too many pictures."""
        rows: list[tuple[int, int, int, int]] = []
        parts: list[npt.NDArray[np.uint8]] = []
        self.numbers: list[int] = []
        total = 0
        for picture in pictures:
            chain = _chain(picture)
            self.numbers.append(len(rows))
            for k, level in enumerate(chain):
                rows.append((total, level.shape[1], level.shape[0], len(chain) - 1 - k))
                parts.append(level.reshape(-1, 3))
                total += level.shape[0] * level.shape[1]
            if 3 * total > MOST_BYTES:
                raise BadTexture(f"the textures of all things have more than {MOST_BYTES >> 20} MB: make them smaller")
        self.levels: Any = np.array(rows, LEVEL)
        self.texels: Picture = np.concatenate(parts) if parts else np.zeros((0, 3), np.uint8)


def _chain(picture: Picture) -> list[Picture]:
    """Return a picture and its coarser copies, down to one texel. They are averaged as light, not as sRGB values."""
    chain = [np.ascontiguousarray(picture)]
    light = LINEAR[picture]
    while max(light.shape[:2]) > 1:
        height, width = (max(1, extent // 2) for extent in light.shape[:2])
        rows = min(2, light.shape[0])
        columns = min(2, light.shape[1])
        cut = light[: height * rows, : width * columns]
        light = cut.reshape(height, rows, width, columns, 3).mean(axis=(1, 3), dtype=np.float32)
        chain.append(encoded(light))
    return chain


_CODES = np.arange(256) / 255.0
LINEAR = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(np.float32)
"""(256) the light of each sRGB value, 0 to 1 (IEC 61966-2-1)."""


def encoded(light: npt.NDArray[np.float32]) -> Picture:
    """Return linear light, 0 to 1, as sRGB values."""
    x = np.clip(light, 0.0, 1.0)
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1.0 / 2.4) - 0.055)
    return np.rint(255.0 * curve).astype(np.uint8)
