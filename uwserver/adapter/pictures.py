"""Pictures of sensors for people: which field holds a picture, what its numbers look like on a screen, and JPEG of that.

A picture is a buffer: ``uint8 [h, w, 3]`` RGB, ``uint8 [h, w]`` grey, ``uint16 [h, w]`` distances in mm (0: nothing) or numbers of objects.
"""

from __future__ import annotations

import importlib.util
import io
from functools import cache
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from uwserver.packages import install_command
from uwserver.ports import Buffer, Field, Port, Sample
from uwserver.ports.pictures import FAR_MM, MOST_PIXELS, Pixels, pixels_of

__all__ = [
    "EXTRA", "FAR_MM", "MOST_PIXELS", "QUALITY", "Levels", "Pixels", "amplitudes", "can_encode_jpeg", "jpeg", "picture_place", "pixels",
    "with_jpeg",
]  # fmt: skip

Levels = NDArray[np.float32]
"""Levels of echoes."""

QUALITY = 80
"""Default quality of JPEG. A view under water of 640 x 480 takes 18 kB, without a visible difference."""
EXTRA = "uwserver[pictures]"


def picture_place(port: Port) -> int | None:
    """Return the index of the port's field that holds pictures: the one named `image`, or else the first; None if there is none."""
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
    """Return what a picture looks like on a screen, or None if a value is no picture, is empty, or has more than `MOST_PIXELS`.

    Distances become grey: the nearer the brighter, and black from `FAR_MM` on and where there is nothing. Each number of an object has a
    colour.
    """
    return pixels_of(picture.array()) if isinstance(picture, Buffer) else None


def amplitudes(echoes: Buffer, dimensions: int = 1) -> Levels:
    """Return echoes with so many dimensions as levels: counts and pressures as they are, and the amplitude of complex echoes.

    Complex echoes have one more dimension of two, the real and the imaginary part.
    """
    heard: Levels = echoes.array().astype(np.float32)
    if heard.ndim == dimensions + 1 and heard.shape[-1] == 2:
        heard = np.hypot(heard[..., 0], heard[..., 1])
    return heard


def can_encode_jpeg() -> bool:
    """Tell whether a library for JPEG is installed."""
    return _jpeg_library() != ""


@cache
def _jpeg_library() -> str:
    return next((name for name in ("simplejpeg", "PIL") if importlib.util.find_spec(name) is not None), "")


def jpeg(shown: Pixels, quality: int = QUALITY) -> bytes:
    """Return a baseline JPEG, with colours at half the resolution (4:2:0). Most of the time is spent without the interpreter lock.

    Args:
        shown: pixels as `pixels` returns them.
        quality: 1 to 100.

    Raises:
        RuntimeError: no library for JPEG is installed.
    """
    is_grey = shown.ndim == 2
    library = _jpeg_library()
    if library == "simplejpeg":
        simplejpeg: Any = importlib.import_module("simplejpeg")
        kinds = ("GRAY", "Gray") if is_grey else ("RGB", "420")
        return bytes(simplejpeg.encode_jpeg(shown[:, :, None] if is_grey else shown, quality, *kinds))
    if library == "PIL":
        image: Any = importlib.import_module("PIL.Image")
        out = io.BytesIO()
        image.fromarray(shown).save(out, "JPEG", quality=quality, subsampling=0 if is_grey else 2)
        return out.getvalue()
    raise RuntimeError(f"JPEG needs simplejpeg or Pillow: {install_command(EXTRA)}")


def with_jpeg(port: Port, sample: Sample) -> Sample:
    """Return the sample with the bytes of a JPEG in place of its picture, or the sample itself if it has none.

    Raises:
        RuntimeError: no library for JPEG is installed.
    """
    place = picture_place(port)
    shown = pixels(sample.value[place]) if place is not None and place < len(sample.value) else None
    if place is None or shown is None:
        return sample
    value = (*sample.value[:place], Buffer(data=jpeg(shown)), *sample.value[place + 1 :])
    return replace(sample, value=value)
