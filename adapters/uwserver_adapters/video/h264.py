"""H.264 in RTP (RFC 6184): splits an encoder's byte stream (Annex B) into payloads of single NAL units and fragments (FU-A). Sans-IO."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence

PAYLOAD_TYPE = 96
ENCODING = "H264/90000"

_START = b"\x00\x00\x01"
_TYPE = 0x1F
_KEY, _SEQUENCE, _PICTURE = 5, 7, 8
_FRAGMENT = 28
_FIRST, _LAST = 0x80, 0x40


def nal_units(stream: bytes) -> list[bytes]:
    """Return the NAL units of a byte stream with start codes (H.264, Annex B). A unit never ends with zero, so zeros belong to the start code."""
    return [unit for part in stream.split(_START)[1:] if (unit := part.rstrip(b"\x00"))]


def is_key(units: Iterable[bytes]) -> bool:
    """Return whether a decoder can begin with this picture."""
    return any(unit[0] & _TYPE == _KEY for unit in units)


def payloads(units: Iterable[bytes], limit: int) -> list[bytes]:
    """Return payloads of at most `limit` bytes, in order. A longer unit is sent in fragments."""
    found = []
    for unit in units:
        if len(unit) <= limit:
            found.append(unit)
            continue
        head, kind, rest = unit[0], unit[0] & _TYPE, memoryview(unit)[1:]
        # A fragment carries the importance of its unit in the first byte, and its type, with begin and end flags, in the second.
        indicator = (head & ~_TYPE & 0xFF) | _FRAGMENT
        for start in range(0, len(rest), limit - 2):
            piece = rest[start : start + limit - 2]
            first = _FIRST if start == 0 else 0
            last = _LAST if start + len(piece) == len(rest) else 0
            found.append(bytes((indicator, first | last | kind)) + piece)
    return found


def parameter_sets(units: Sequence[bytes]) -> tuple[bytes, bytes] | None:
    """Return sequence and picture parameters if both are among the units."""
    found = {unit[0] & _TYPE: unit for unit in units}
    sequence, picture = found.get(_SEQUENCE), found.get(_PICTURE)
    return None if sequence is None or picture is None or len(sequence) < 4 else (sequence, picture)


def format_parameters(sets: tuple[bytes, bytes] | None) -> str:
    """Return the format parameters of a session description (RFC 6184, 8.1). The parameter sets also come with each key picture."""
    text = "packetization-mode=1"
    if sets is not None:
        given = ",".join(base64.b64encode(entry).decode() for entry in sets)
        text += f";profile-level-id={sets[0][1:4].hex()};sprop-parameter-sets={given}"
    return text
