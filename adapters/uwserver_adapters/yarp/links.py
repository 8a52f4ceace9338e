"""Connections that a port of this server makes when somebody asks it to send to another port (`yarp connect`)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, cast

from uwserver.adapter import HIGH_WATER, AdapterStats, Peers, within
from uwserver.ports import Refused
from uwserver_adapters.yarp import wire
from uwserver_adapters.yarp.names import ANSWER_S, Address
from uwserver_adapters.yarp.port import YarpPort
from uwserver_adapters.yarp.wire import Carrier

GREETING_LIMIT = 1 << 11
"""Longest answer to our hello, bytes."""


class Link(asyncio.Protocol):
    """A connection from a port of ours to another port, which hears it. Acknowledgements are ignored.

    Args:
        port: our port.
        name: name of the other port.
        carrier: of the connection.
        peers: all connections of the adapter.
        stats: of the adapter.
        queue_bytes: most bytes that wait for the other side.
        lost: called when the connection has ended.

    Attributes:
        name, carrier: as given.
        is_half_open: always False, as nothing is expected of the other side.
        greeted: done when the other side has answered.
    """

    is_half_open = False

    def __init__(
        self, port: YarpPort, name: str, carrier: Carrier, peers: Peers[Any], stats: AdapterStats, queue_bytes: int,
        lost: Callable[[Link], None],
    ) -> None:  # fmt: skip
        self.name = name
        self.carrier: Carrier = carrier
        self.greeted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._port, self._peers, self._stats, self._queue_bytes = port, peers, stats, queue_bytes
        self._lost = lost
        self._transport: asyncio.Transport | None = None
        self._answer = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send our hello, if there is a place for the connection."""
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(HIGH_WATER)
        self._peers.enter(self)
        fault = self._peers.admit(self)
        if fault is not None:
            self._fail(Refused(fault.code, fault.text))
            return
        self._transport.write(wire.hello(self.carrier, self._port.name))

    def data_received(self, data: bytes) -> None:
        """Take the answer to the hello."""
        if self.greeted.done():
            return
        self._answer += data
        # YARP answers on both text carriers, though its own writers wait for the answer on only one of them.
        if wire.is_text(self.carrier):
            is_right = self._answer.startswith(b"Welcome"[: len(self._answer)])
            is_whole = b"\n" in self._answer
        else:
            is_right = self._answer.startswith(b"YA"[: len(self._answer)])
            is_whole = len(self._answer) >= 8
        if not is_right or len(self._answer) > GREETING_LIMIT:
            self._fail(Refused("invalid_request", "what listens there is no port of YARP"))
        elif is_whole:
            self.greeted.set_result(None)

    def connection_lost(self, error: Exception | None) -> None:
        """End the link."""
        self._peers.leave(self)
        self._lost(self)
        self._fail(Refused("internal", "it closed the connection without an answer"))

    def _fail(self, why: Refused) -> None:
        if not self.greeted.done():
            self.greeted.set_exception(why)
        self.abort()

    def send_sample(self, message: bytes) -> None:
        """Send a message; drop it while too much waits."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        if transport.get_write_buffer_size() > self._queue_bytes:
            self._stats.dropped += 1
            return
        self._stats.samples_sent += 1
        self._stats.bytes_sent += len(message)
        transport.write(message)

    def close(self) -> None:
        """Say that the connection ends, then close it."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(wire.message(wire.is_text(self.carrier), "q"))
            self._transport.close()

    def abort(self) -> None:
        """Close the connection at once."""
        if self._transport is not None:
            self._transport.abort()


async def connect(link: Link, address: Address) -> None:
    """Make the connection of a link.

    Raises:
        OSError: nobody is there, or does not answer in time.
        Refused: it is no port of YARP, or there is no place for the connection.
    """
    loop = asyncio.get_running_loop()

    async def make() -> None:
        await loop.create_connection(lambda: link, address.host, address.port)
        await link.greeted

    try:
        await within(ANSWER_S, make(), "it did not answer")
    except BaseException:
        link.abort()
        if link.greeted.done() and not link.greeted.cancelled():
            link.greeted.exception()  # reported already; asyncio must not log it again
        raise
