"""Pictures of sensors as people see them: which field holds one, what its numbers look like on a screen, and JPEG of that.

A picture is a buffer: ``uint8 [h, w, 3]`` RGB, ``uint8 [h, w]`` grey, ``uint16 [h, w]`` distances in mm (0: nothing) or numbers of objects.
"""

from __future__ import annotations

import importlib.util
import io
from functools import lru_cache
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from uwserver.ports import Buffer, Field, Port, Sample

__all__ = [
    "EXTRA", "FAR_MM", "MOST_PIXELS", "QUALITY", "Levels", "Pixels", "amplitudes", "can_encode_jpeg", "jpeg", "picture_place", "pixels",
    "with_jpeg",
]  # fmt: skip

Pixels = NDArray[np.uint8]
"""``[h, w, 3]`` RGB or ``[h, w]`` grey, contiguous."""
Levels = NDArray[np.float32]
"""Of echoes."""

QUALITY = 80
"""Of JPEG: 18 kB of a view under water of 640 x 480, in which no one sees a difference."""
MOST_PIXELS = 1 << 24
"""Of a picture that is shown; 4096 x 4096."""
FAR_MM = 20_000
"""Distance that is shown black; nearer is brighter."""
_IDS = 256
"""Numbers of objects stand below; a picture of distances holds larger ones."""
EXTRA = "uwserver[pictures]"


def picture_place(port: Port) -> int | None:
    """Which of the port's fields holds pictures of two dimensions: the one named `image`, or else the first; None where none does."""
    places = [place for place, field in enumerate(port.fields) if _is_picture(field)]
    named = [place for place in places if port.fields[place].name == "image"]
    return next(iter(named or places), None) if port.direction == "sensor" else None


def _is_picture(field: Field) -> bool:
    if field.type != "buffer" or not field.buffer:
        return False
    shape, dtype = field.buffer.shape, field.buffer.dtype
    return (len(shape) == 2 and dtype in ("uint8", "uint16")) or (
        len(shape) == 3 and shape[2] == 3 and dtype == "uint8"
    )


def pixels(picture: object) -> Pixels | None:
    """What a picture looks like on a screen; None where a value is no picture, an empty one, or one of more than `MOST_PIXELS`.

    Distances are grey, bright where near, black from `FAR_MM` on and where there is nothing; numbers of objects have a colour each.
    """
    if not isinstance(picture, Buffer):
        return None
    shape = picture.shape
    if len(shape) not in (2, 3) or not 0 < shape[0] * shape[1] <= MOST_PIXELS:
        return None
    if picture.dtype == "uint8" and (len(shape) == 2 or shape[2] == 3):
        return picture.array()
    if picture.dtype == "uint16" and len(shape) == 2:
        return _of_numbers(picture.array())
    return None


def _of_numbers(numbers: NDArray[np.uint16]) -> Pixels:
    if int(numbers.max()) < _IDS:
        return np.ascontiguousarray(_colours()[numbers])
    return _brightness()[numbers]


@lru_cache(maxsize=1)
def _colours() -> Pixels:
    """A colour for each number of an object, neighbours far apart; black for 0."""
    hue = (np.arange(_IDS) * 0.618034) % 1.0
    channels = np.abs((hue[:, None] + np.array([0.0, 2 / 3, 1 / 3])) % 1.0 * 6.0 - 3.0) - 1.0
    table: Pixels = (64 + 191 * np.clip(channels, 0.0, 1.0)).astype(np.uint8)
    table[0] = 0
    return table


@lru_cache(maxsize=1)
def _brightness() -> Pixels:
    """Grey of each distance in mm."""
    grey: Pixels = (255 - np.arange(1 << 16) * 255 // FAR_MM).clip(0, 255).astype(np.uint8)
    grey[0] = 0
    return grey


def amplitudes(echoes: Buffer, dimensions: int = 1) -> Levels:
    """What echoes of so many dimensions look like: counts and pressures as they are; of real and imaginary parts, one dimension more of two, their
    amplitude."""
    heard: Levels = echoes.array().astype(np.float32)
    if heard.ndim == dimensions + 1 and heard.shape[-1] == 2:
        heard = np.hypot(heard[..., 0], heard[..., 1])
    return heard


def can_encode_jpeg() -> bool:
    """Whether a library for JPEG is installed."""
    return _jpeg_library() != ""


@lru_cache(maxsize=1)
def _jpeg_library() -> str:
    return next((name for name in ("simplejpeg", "PIL") if importlib.util.find_spec(name) is not None), "")


def jpeg(shown: Pixels, quality: int = QUALITY) -> bytes:
    """A baseline JPEG, of colours with half their resolution (4:2:0). Most of the time is spent without the interpreter lock.

    Args:
        shown: as `pixels` gives it.
        quality: 1 to 100.

    Raises:
        RuntimeError: no library for JPEG is installed.
    """
    library = _jpeg_library()
    if library == "simplejpeg":
        return _by_simplejpeg(shown, quality)
    if library == "PIL":
        return _by_pillow(shown, quality)
    raise RuntimeError(f"JPEG needs simplejpeg or Pillow: pip install '{EXTRA}'")


def with_jpeg(port: Port, sample: Sample) -> Sample:
    """The sample with the bytes of a JPEG for its picture; itself where it holds none.

    Raises:
        RuntimeError: no library for JPEG is installed.
    """
    place = picture_place(port)
    shown = pixels(sample.value[place]) if place is not None and place < len(sample.value) else None
    if place is None or shown is None:
        return sample
    value = (*sample.value[:place], Buffer(data=jpeg(shown)), *sample.value[place + 1 :])
    return replace(sample, value=value)


def _by_simplejpeg(shown: Pixels, quality: int) -> bytes:
    simplejpeg: Any = importlib.import_module("simplejpeg")
    if shown.ndim == 2:
        return bytes(simplejpeg.encode_jpeg(shown[:, :, None], quality, "GRAY", "Gray"))
    return bytes(simplejpeg.encode_jpeg(shown, quality, "RGB", "420"))


def _by_pillow(shown: Pixels, quality: int) -> bytes:
    image: Any = importlib.import_module("PIL.Image")
    out = io.BytesIO()
    image.fromarray(shown).save(out, "JPEG", quality=quality, subsampling=0 if shown.ndim == 2 else 2)
    return out.getvalue()
