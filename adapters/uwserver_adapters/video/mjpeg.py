"""JPEG in RTP (RFC 2435): each picture is complete, with its quantisation tables. Sans-IO.

The Huffman tables are those of the standard's annex K. The receiver knows them, and encoders use them unless asked for optimised ones.
"""

from __future__ import annotations

import struct

PAYLOAD_TYPE = 26
ENCODING = "JPEG/90000"
LARGEST = 255 * 8
"""Longest side, pixels: the header holds an eighth of it in a byte."""

_START, _END, _TABLES, _FRAME, _HUFFMAN, _RESTART, _SCAN = 0xD8, 0xD9, 0xDB, 0xC0, 0xC4, 0xDD, 0xDA
_TYPE_422, _TYPE_420 = 0, 1
_OWN_TABLES = 255
"""Value of the quality that says that the tables follow."""
_HEAD = struct.Struct(">I4B")
_TABLE_HEAD = struct.Struct(">BBH")


class NotSendable(Exception):
    """RTP cannot carry this JPEG. The text says why."""


def payloads(jpeg: bytes, limit: int) -> list[bytes]:
    """Return payloads of at most `limit` bytes for a baseline JPEG in colour, 4:2:0 or 4:2:2.

    Raises:
        NotSendable: it is another kind of JPEG, too large, or no JPEG.
    """
    kind, width, height, tables, scan = _parts(jpeg)
    if max(width, height) > LARGEST:
        raise NotSendable(
            f'JPEG by RTP has at most {LARGEST} pixels a side, not {width} x {height}: set codec = "h264"'
        )
    found: list[bytes] = []
    at = 0
    while at < len(scan):
        head = _HEAD.pack(at, kind, _OWN_TABLES, (width + 7) // 8, (height + 7) // 8)
        if at == 0:
            head += _TABLE_HEAD.pack(0, 0, len(tables)) + tables
        piece = scan[at : at + limit - len(head)]
        found.append(head + piece)
        at += len(piece)
    return found


def _parts(jpeg: bytes) -> tuple[int, int, int, bytes, bytes]:
    """Return the type of RFC 2435, width, height, quantisation tables, and the coded picture."""
    if jpeg[:2] != bytes((0xFF, _START)):
        raise NotSendable("this is no JPEG")
    tables: dict[int, bytes] = {}
    frame = b""
    at = 2
    while at + 4 <= len(jpeg):
        if jpeg[at] != 0xFF:
            break
        marker, size = jpeg[at + 1], int.from_bytes(jpeg[at + 2 : at + 4], "big")
        body = jpeg[at + 4 : at + 2 + size]
        at += 2 + size
        if marker == _TABLES:
            while len(body) >= 65 and body[0] < 16:
                tables[body[0]], body = body[1:65], body[65:]
        elif marker == _FRAME:
            frame = body
        elif marker == _RESTART and any(body):
            raise NotSendable("JPEG by RTP has no restart intervals here")
        elif marker == _SCAN:
            end = len(jpeg) - 2 if jpeg.endswith(bytes((0xFF, _END))) else len(jpeg)
            return (*_frame(frame, tables), jpeg[at:end])
    raise NotSendable("the JPEG has no baseline picture")


def _frame(frame: bytes, tables: dict[int, bytes]) -> tuple[int, int, int, bytes]:
    if len(frame) < 15 or frame[5] != 3:
        raise NotSendable("JPEG by RTP has three components, 8 bits each")
    kind = {0x21: _TYPE_422, 0x22: _TYPE_420}.get(frame[7])
    luminance, chrominance = tables.get(frame[8]), tables.get(frame[11])
    if kind is None or frame[10] != 0x11 or frame[13] != 0x11 or luminance is None or chrominance is None:
        raise NotSendable("JPEG by RTP is 4:2:0 or 4:2:2")
    height, width = struct.unpack_from(">HH", frame, 1)
    return kind, width, height, luminance + chrominance
