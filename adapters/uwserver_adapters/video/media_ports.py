"""Our two ports of UDP, for RTP and for its reports, to all clients of RTSP that take datagrams."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final, cast

from uwserver.adapter import CannotListen, cannot_listen

Address = tuple[str, int]

_TRIES: Final = 16
WAITING: Final = 1 << 20
"""Bytes that may wait for the system; what comes more is dropped."""


class MediaPorts:
    """Opened once, closed once.

    Args:
        bind: address of the server.
    """

    def __init__(self, bind: str) -> None:
        self._bind = bind
        self._pair: tuple[asyncio.DatagramTransport, asyncio.DatagramTransport] | None = None
        self._heard: dict[Address, Callable[[], None]] = {}

    async def open(self) -> None:
        """Take an even port and the next one, as receivers expect it.

        Raises:
            CannotListen: there is none.
        """
        for _ in range(_TRIES):
            first = await self._bound(0)
            number = int(first.get_extra_info("sockname")[1])
            other = number + 1 if number % 2 == 0 else number - 1
            try:
                second = await self._bound(other)
            except CannotListen:
                first.abort()
                continue
            self._pair = (first, second) if number % 2 == 0 else (second, first)
            return
        self._pair = (await self._bound(0), await self._bound(0))

    async def _bound(self, port: int) -> asyncio.DatagramTransport:
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(lambda: _Ear(self._heard), local_addr=(self._bind, port))
        except OSError as error:
            raise cannot_listen(error, self._bind, port, "udp", key="udp") from error
        return transport

    @property
    def numbers(self) -> tuple[int, int]:
        """Our ports."""
        assert self._pair is not None
        first, second = self._pair
        return int(first.get_extra_info("sockname")[1]), int(second.get_extra_info("sockname")[1])

    def enter(self, reports_of: Address, heard: Callable[[], None]) -> None:
        """Call `heard` for each report that comes from there."""
        self._heard[reports_of] = heard

    def leave(self, reports_of: Address) -> None:
        """No more."""
        self._heard.pop(reports_of, None)

    def send(self, packets: list[bytes], report: bytes, to: tuple[Address, Address]) -> bool:
        """Packets and a report (b"" for none) to ports of a client; False when the system does not take them."""
        assert self._pair is not None
        media, reports = self._pair
        # Typeshed does not know it of datagrams; asyncio and uvloop have it.
        if media.is_closing() or cast(asyncio.WriteTransport, media).get_write_buffer_size() > WAITING:
            return False
        for packet in packets:
            media.sendto(packet, to[0])
        if report:
            reports.sendto(report, to[1])
        return True

    def close(self) -> None:
        """Give the ports back."""
        for transport in self._pair or ():
            transport.abort()
        self._heard.clear()


class _Ear(asyncio.DatagramProtocol):
    """Reports of receivers, and what else comes."""

    def __init__(self, heard: dict[Address, Callable[[], None]]) -> None:
        self._heard = heard

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Who reports is there; what it says is of no use here."""
        heard = self._heard.get((addr[0], addr[1]))
        if heard is not None and 192 <= (data[1] if len(data) >= 8 else 0) <= 223:
            heard()

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there any more: silence tells it."""
