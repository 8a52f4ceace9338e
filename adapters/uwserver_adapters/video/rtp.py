"""RTP (RFC 3550): the packets of one stream, the same for all receivers, and the sender reports. Sans-IO."""

from __future__ import annotations

import struct
from collections.abc import Sequence

LIMIT = 1200
"""Longest payload, bytes. With all headers a packet fits into 1280 bytes, which every network carries."""
NTP_1970_S = 2_208_988_800
"""Seconds from 1900, where NTP begins, to 1970 (RFC 5905)."""

_HEAD = struct.Struct(">BBHII")
_REPORT = struct.Struct(">BBHIIIIII")
_NAME = struct.Struct(">BBHI")
_VERSION = 0x80
_MARKER = 0x80
_SENDER_REPORT, _SOURCE_DESCRIPTION, _CNAME = 200, 202, 1
_NS = 1_000_000_000


class Packets:
    """The packets of one stream.

    Args:
        payload_type: type of the payload: below 96 from RFC 3551, from 96 on from the session description.
        source: number of the source (SSRC).
        seq: sequence number of the first packet.
        offset: offset of the time stamps. Both begin at any number, so that streams differ.
        epoch_unix_ns: UTC of simulation time zero, ns since 1970.

    Attributes:
        seq: sequence number of the next packet.
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
        """Return the time stamp of a simulation time."""
        # The clock of video, 90 kHz (RFC 6184, RFC 2435), is 9 stamps per 100 us. Integers keep it exact however long the simulation runs.
        return (self._offset + t_ns * 9 // 100_000) & 0xFFFF_FFFF

    def of(self, payloads: Sequence[bytes], t_ns: int) -> list[bytes]:
        """Return the packets of one picture. The last one is marked.

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
        """Return a sender report. It tells receivers which time a stamp means: simulation time, not the machine's."""
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
