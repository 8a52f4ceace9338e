"""RTP (RFC 3550): packets of one stream, the same for all who take it, and the sender's report. Sans-IO."""

from __future__ import annotations

import struct
from collections.abc import Sequence

CLOCK_HZ = 90_000
"""Of the stamps of video (RFC 6184, RFC 2435)."""
LIMIT = 1200
"""Bytes of a payload: with all heads it passes the 1280 bytes that every network takes."""
NTP_1970_S = 2_208_988_800
"""From 1900, where NTP begins, to 1970 (RFC 5905)."""

_HEAD = struct.Struct(">BBHII")
_REPORT = struct.Struct(">BBHIIIIII")
_NAME = struct.Struct(">BBHI")
_VERSION = 0x80
_MARKER = 0x80
_SENDER_REPORT, _SOURCE_DESCRIPTION, _CNAME = 200, 202, 1
_NS = 1_000_000_000


class Packets:
    """Packets of one stream.

    Args:
        payload_type: of the payload; below 96 as RFC 3551 has it, from 96 on as the description of the session says.
        source: number of the source (SSRC).
        seq: of the first packet.
        offset: of the stamps; both begin anywhere, so that streams are told apart.
        epoch_unix_ns: time at which the simulation begins.

    Attributes:
        seq: of the next packet.
    """

    def __init__(self, payload_type: int, source: int, seq: int, offset: int, epoch_unix_ns: int) -> None:
        self.seq = seq & 0xFFFF
        self._payload_type = payload_type
        self._source = source
        self._offset = offset
        self._epoch_ns = epoch_unix_ns
        self._packets = 0
        self._octets = 0

    def stamp(self, t_ns: int) -> int:
        """Of a simulation time."""
        return (self._offset + t_ns * 9 // 100_000) & 0xFFFF_FFFF

    def of(self, payloads: Sequence[bytes], t_ns: int) -> list[bytes]:
        """The packets of one picture, which the last one is marked to end.

        Args:
            payloads: at most `LIMIT` bytes each.
            t_ns: simulation time of the picture.
        """
        stamp, last = self.stamp(t_ns), len(payloads) - 1
        packets = []
        for place, payload in enumerate(payloads):
            mark = _MARKER if place == last else 0
            packets.append(_HEAD.pack(_VERSION, mark | self._payload_type, self.seq, stamp, self._source) + payload)
            self.seq = (self.seq + 1) & 0xFFFF
            self._octets += len(payload)
        self._packets += len(packets)
        return packets

    def report(self, t_ns: int) -> bytes:
        """The sender's report, by which a receiver knows the time of each stamp: that of the simulation, not the machine's."""
        seconds, rest = divmod(self._epoch_ns + t_ns, _NS)
        report = _REPORT.pack(
            _VERSION, _SENDER_REPORT, 6, self._source,
            (seconds + NTP_1970_S) & 0xFFFF_FFFF, (rest << 32) // _NS, self.stamp(t_ns),
            self._packets & 0xFFFF_FFFF, self._octets & 0xFFFF_FFFF,
        )  # fmt: skip
        name = b"uwserver"
        items = bytes((_CNAME, len(name))) + name
        items += bytes(4 - len(items) % 4)
        return report + _NAME.pack(_VERSION | 1, _SOURCE_DESCRIPTION, 1 + len(items) // 4, self._source) + items
