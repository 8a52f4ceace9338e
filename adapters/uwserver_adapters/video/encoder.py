"""Encodes pixels to RTP payloads with PyAV (libx264) or a JPEG library. Runs on the thread of one stream, never on the loop."""

from __future__ import annotations

import importlib
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

import numpy as np

from uwserver.adapter.pictures import Pixels, jpeg
from uwserver_adapters.video import h264, mjpeg
from uwserver_adapters.video.rtp import LIMIT

SMALLEST = 16
"""Smallest side that an encoder accepts, pixels. A smaller picture is padded."""
_HD = 720
"""Height from which players assume the colours of BT.709."""


class Coded(NamedTuple):
    """One encoded picture.

    Attributes:
        payloads: payloads for RTP.
        is_key: a receiver can begin with it.
        size: bytes.
        format: format parameters for the session description; "" for none.
    """

    payloads: list[bytes]
    is_key: bool
    size: int
    format: str


class Encoder(Protocol):
    """Encodes the pictures of a stream."""

    def encode(self, shown: Pixels, wants_key: bool) -> Coded | None:
        """Return the next encoded picture; None if the encoder holds it back.

        Args:
            shown: pixels of any size; a change of size begins a new sequence.
            wants_key: a receiver must be able to begin with this picture.
        """

    def close(self) -> None:
        """Release the encoder."""


class JpegEncoder:
    """Encodes each picture on its own.

    Args:
        quality: 1 to 100.
    """

    def __init__(self, quality: int) -> None:
        self._quality = quality

    def encode(self, shown: Pixels, wants_key: bool) -> Coded:
        """Encode a picture, see `Encoder`. Raises `mjpeg.NotSendable`."""
        data = jpeg(_filled(_in_colour(shown)), self._quality)
        return Coded(mjpeg.payloads(data, LIMIT), True, len(data), "")

    def close(self) -> None:
        """Do nothing: the encoder keeps nothing."""


class H264Encoder:
    """Encodes with libx264 for low latency: no picture waits for later ones, one thread, and each second a key picture with all parameters.

    Args:
        rate_hz: pictures per second of simulation time.
        bit_rate: most bits per second.
        preset: preset of x264; slower ones reach the same quality with fewer bits.
    """

    def __init__(self, rate_hz: float, bit_rate: int, preset: str) -> None:
        self._av: Any = importlib.import_module("av")
        self._rate_hz = rate_hz
        self._bit_rate = bit_rate
        self._preset = preset
        self._context: Any = None
        self._size = (0, 0)
        self._number = 0
        self._format = h264.format_parameters(None)

    def encode(self, shown: Pixels, wants_key: bool) -> Coded | None:
        """Encode a picture, see `Encoder`."""
        shown = _even(_filled(_in_colour(shown)))
        height, width = shown.shape[:2]
        if (width, height) != self._size:
            self._begin(width, height)
        frame = self._av.VideoFrame.from_ndarray(shown, format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=_colours(height)[0])
        frame.pts = self._number
        frame.time_base = self._context.time_base
        if wants_key:
            frame.pict_type = self._av.video.frame.PictureType.I
        self._number += 1
        data = b"".join(bytes(packet) for packet in self._context.encode(frame))
        units = h264.nal_units(data)
        if not units:
            return None
        sets = h264.parameter_sets(units)
        if sets is not None:
            self._format = h264.format_parameters(sets)
        return Coded(h264.payloads(units, LIMIT), h264.is_key(units), len(data), self._format)

    def close(self) -> None:
        """Release the encoder's memory."""
        self._context = None
        self._size = (0, 0)

    def _begin(self, width: int, height: int) -> None:
        context = self._av.CodecContext.create("libx264", "w")
        context.width, context.height, context.pix_fmt = width, height, "yuv420p"
        rate = Fraction(self._rate_hz).limit_denominator(1001)
        context.framerate, context.time_base = rate, 1 / rate
        context.thread_count = 1
        context.gop_size = max(round(self._rate_hz), 1)
        _, context.colorspace, context.color_primaries, context.color_trc = _colours(height)
        context.color_range = 1  # 16 to 235
        context.options = {
            "preset": self._preset, "tune": "zerolatency", "profile": "baseline", "crf": "23", "forced-idr": "1",
            "maxrate": str(self._bit_rate), "bufsize": str(self._bit_rate // 2),
            "x264-params": "repeat-headers=1:scenecut=0:sliced-threads=0",
        }  # fmt: skip
        context.open()
        self._context, self._size, self._number = context, (width, height), 0


def _colours(height: int) -> tuple[str, int, int, int]:
    """Return the colour space for the conversion, and matrix, primaries and transfer as H.264 numbers them (tables E-3 to E-5)."""
    return ("itu709", 1, 1, 1) if height >= _HD else ("itu601", 6, 6, 6)


def _in_colour(shown: Pixels) -> Pixels:
    return np.repeat(shown[:, :, None], 3, axis=2) if shown.ndim == 2 else shown


def _filled(shown: Pixels) -> Pixels:
    rows, columns = (max(SMALLEST - extent, 0) for extent in shown.shape[:2])
    return np.pad(shown, ((0, rows), (0, columns), (0, 0)), mode="edge") if rows or columns else shown


def _even(shown: Pixels) -> Pixels:
    """Return the picture without an odd last row or column: colours have half the resolution."""
    height, width = shown.shape[:2]
    return shown if not (height % 2 or width % 2) else np.ascontiguousarray(shown[: height & ~1, : width & ~1])
