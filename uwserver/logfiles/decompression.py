"""Decompresses the chunks and messages of logs up to a limit, so that a small file cannot fill the memory."""

from __future__ import annotations

import bz2
from typing import Any

import lz4.frame
import zstandard


def decompressed(kind: str, data: bytes, most: int) -> bytes | None:
    """Return decompressed data; None when they are truncated or have more than `most` bytes.

    Args:
        kind: "zstd", "lz4", "bz2", or "" for data that are not compressed.
        data: compressed.
        most: largest number of bytes.

    Raises:
        ValueError: the kind is unknown.
        Exception: the data are damaged; each library raises its own exception.
    """
    if kind == "":
        return data
    if kind not in ("zstd", "lz4", "bz2"):
        raise ValueError(f"the compression {kind[:20]!r} is unknown: only zstd and lz4 can be read")
    if kind == "zstd":
        found: bytes = zstandard.ZstdDecompressor().stream_reader(data).read(most + 1)
        return found if len(found) <= most else None
    stream: Any = lz4.frame.LZ4FrameDecompressor() if kind == "lz4" else bz2.BZ2Decompressor()
    found = stream.decompress(data, max_length=most + 1)
    return found if stream.eof and len(found) <= most else None
