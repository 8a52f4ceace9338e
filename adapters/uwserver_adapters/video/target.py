"""An address of the table, to which a stream goes whether or not somebody listens."""

from __future__ import annotations

import asyncio
from typing import cast

from uwserver.adapter import AdapterStats
from uwserver_adapters.video.stream import Picture

WAITING = 1 << 20
"""Bytes that may wait for the system; pictures are left out above."""


class Target:
    """Takes a stream.

    Args:
        transport: of a socket that no port needs.
        address: host and port. No reports go to the next one, where another stream may be sent.
        stats: of the adapter.
    """

    def __init__(self, transport: asyncio.DatagramTransport, address: tuple[str, int], stats: AdapterStats) -> None:
        self._transport = transport
        self._address = address
        self._stats = stats

    def take(self, picture: Picture) -> None:
        """Send a picture."""
        transport = self._transport
        # Typeshed does not know it of datagrams; asyncio and uvloop have it.
        if transport.is_closing() or cast(asyncio.WriteTransport, transport).get_write_buffer_size() > WAITING:
            self._stats.dropped += 1
            return
        for packet in picture.packets:
            transport.sendto(packet, self._address)
        self._stats.samples_sent += 1
        self._stats.bytes_sent += picture.size
