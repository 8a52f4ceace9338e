"""Writes the pictures of one topic as a video (MP4, H.264), in which each appears at its own time. Needs PyAV."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Iterator, Mapping
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.adapter.pictures import MOST_PIXELS, Pixels, pixels
from uwserver.logfiles.log import Log, LogError
from uwserver.ports import Buffer
from uwserver.ports.buffer import unpacked

TICKS_HZ = 90_000
_LOOKED_AT = 50
"""Number of data in which a picture is sought, because a camera may not give one at once."""
_SMALLEST = 16
_HD = 720
"""Height in pixels from which players assume the colours of BT.709."""


def write_mp4(log: Log, topics: Collection[str], target: Path) -> list[str]:
    """Write the video.

    Args:
        log: an open log.
        topics: exactly one of them must contain pictures, either ours or compressed ones as in ROS and Foxglove messages.
        target: the file; an old one is overwritten.

    Returns:
        Remarks about the video.

    Raises:
        ImportError: PyAV is not installed.
        LogError: no topic contains pictures, or several do.
    """
    av: Any = importlib.import_module("av")
    topic = _the_topic(log, topics, av)
    found = _pictures(log, topic, av)
    first = next(found, None)
    if first is None:
        raise LogError(f"{log.path}: {topic} contains no picture that can be shown")
    height, width = (max(extent & ~1, _SMALLEST) for extent in first[1].shape[:2])
    count, resized = 0, 0
    last = -1
    with av.open(str(target), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", options={"crf": "20", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS_HZ)
        context, is_hd = stream.codec_context, height >= _HD
        context.colorspace = context.color_primaries = context.color_trc = 1 if is_hd else 6
        for t_ns, shown in chain((first,), found):
            resized += shown.shape[:2] != first[1].shape[:2]
            frame = av.VideoFrame.from_ndarray(_in_colour(shown), format="rgb24")
            frame = frame.reformat(width, height, "yuv420p", dst_colorspace="itu709" if is_hd else "itu601")
            at = (t_ns - first[0]) * 9 // 100_000
            frame.pts = last = max(at, last + 1)
            frame.time_base = stream.time_base
            container.mux(stream.encode(frame))
            count += 1
        container.mux(stream.encode(None))
    remarks = [f"{count} pictures of {topic}, {width} x {height}"]
    if resized:
        remarks.append(f"{resized} of them had another size and were stretched")
    return remarks


def _the_topic(log: Log, topics: Collection[str], av: Any) -> str:
    found = [name for name in log.topics if name in topics and _has_picture(log, name, av)]
    # Our recordings have the same pictures a second time, in a channel for other viewers.
    found = [name for name in found if not (name.startswith("/") and name[1:] in found)]
    if not found:
        raise LogError(f"{log.path}: none of these topics contains pictures: {', '.join(list(topics)[:40])}")
    if len(found) > 1:
        raise LogError(f"{log.path}: several topics contain pictures, choose one by --topics: {', '.join(found[:40])}")
    return found[0]


def _has_picture(log: Log, topic: str, av: Any) -> bool:
    is_ours = log.kind == "uwserver" and not topic.startswith("/")
    if is_ours and all(field.type != "object" for field in log.topics[topic].fields):
        return False
    return any(_picture_of(datum.value, av) is not None for datum in islice(log.read([topic]), _LOOKED_AT))


def _pictures(log: Log, topic: str, av: Any) -> Iterator[tuple[int, Pixels]]:
    for datum in log.read([topic]):
        shown = _picture_of(datum.value, av)
        if shown is not None:
            yield datum.t_ns, shown


def _picture_of(value: Mapping[str, object], av: Any) -> Pixels | None:
    """Return the picture in a datum: a compressed picture, or a buffer among its fields, the one named `image` first; None without one."""
    data = value.get("data")
    if isinstance(data, bytes) and "format" in value:
        return _decompressed(data, av)
    fields = value.get("value", value)
    if not isinstance(fields, Mapping):
        return None
    for entry in (fields.get("image"), *fields.values()):
        buffer = entry if isinstance(entry, Buffer) else _buffer(entry)
        shown = pixels(buffer)
        if shown is not None:
            return shown
    return None


def _buffer(entry: object) -> Buffer | None:
    if not isinstance(entry, Mapping) or "dtype" not in entry:
        return None
    try:
        return unpacked(entry)
    except ValueError:
        return None


def _decompressed(data: bytes, av: Any) -> Pixels | None:
    """Decode JPEG or PNG; None when it is damaged, or its header claims more than `MOST_PIXELS`."""
    name = "png" if data[:4] == b"\x89PNG" else "mjpeg"
    try:
        context = av.CodecContext.create(name, "r")
        context.options = {"max_pixels": str(MOST_PIXELS)}
        frames = context.decode(av.Packet(data))
    except av.FFmpegError:
        return None
    shown: Pixels | None = frames[0].to_ndarray(format="rgb24") if frames else None
    return shown


def _in_colour(shown: Pixels) -> Pixels:
    return np.repeat(shown[:, :, None], 3, axis=2) if shown.ndim == 2 else np.ascontiguousarray(shown)
