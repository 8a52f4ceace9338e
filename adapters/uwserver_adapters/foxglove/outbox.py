"""One connection: until its greeting it stands at the door, and then it has a queue of what is sent."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable

from websockets.asyncio.server import ServerConnection

from uwserver.adapter import STRANGERS, AdapterStats, Refusals


class Door:
    """Counts the connections whose handshake is not over. Loop thread.

    Args:
        refusals: counts those that are closed.
    """

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self._waiting: dict[ServerConnection, None] = {}

    def connections(self) -> type[ServerConnection]:
        """Return the class of connections that `websockets.asyncio.server.serve` makes for each peer."""
        door = self

        class Knocking(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                door._enter(self)

            def connection_lost(self, exc: Exception | None) -> None:
                door.leave(self)
                super().connection_lost(exc)

        return Knocking

    def _enter(self, connection: ServerConnection) -> None:
        self._waiting[connection] = None
        if len(self._waiting) > STRANGERS:
            self._refusals.note(
                "strangers", f"more than {STRANGERS} connections have not greeted: the oldest is closed"
            )
            oldest = next(iter(self._waiting))
            self.leave(oldest)
            oldest.transport.abort()

    def leave(self, connection: ServerConnection) -> None:
        """Count a connection no more: its handshake is over, or it has gone."""
        self._waiting.pop(connection, None)


class Outbox:
    """Sends to a client as fast as it reads. Loop thread.

    Args:
        send: sends one message, text or binary; waits while the client does not read.
        most, most_bytes: most messages and bytes that may wait.
        stats: counts what is sent and dropped.
        overflow: called once, when too much waits even without the samples: the client reads too slowly. Everything is dropped from then on.
    """

    def __init__(
        self,
        send: Callable[[str | bytes], Awaitable[None]],
        most: int,
        most_bytes: int,
        stats: AdapterStats,
        overflow: Callable[[], None],
    ) -> None:
        self._send, self._most, self._most_bytes = send, most, most_bytes
        self._stats, self._overflow = stats, overflow
        self._waiting: deque[tuple[str | bytes, bool]] = deque()
        self._bytes = 0
        self._is_over = False
        self._wake = asyncio.Event()

    def put(self, message: bytes, *, is_text: bool = False, is_sample: bool = False) -> None:
        """Let a message wait for its turn."""
        if self._is_over:
            self._stats.dropped += 1
            return
        self._waiting.append((message.decode() if is_text else message, is_sample))
        self._bytes += len(message)
        self._wake.set()
        if len(self._waiting) > self._most or self._bytes > self._most_bytes:
            self._make_room()

    def _make_room(self) -> None:
        kept = deque(entry for entry in self._waiting if not entry[1])
        self._stats.dropped += len(self._waiting) - len(kept)
        self._waiting = kept
        self._bytes = sum(len(entry[0]) for entry in kept)
        if len(kept) > self._most or self._bytes > self._most_bytes:
            self._is_over = True
            self._stats.dropped += len(kept)
            self._waiting.clear()
            self._bytes = 0
            self._overflow()

    async def run(self) -> None:
        """Send until cancelled, or until the client has gone."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._waiting:
                message, is_sample = self._waiting.popleft()
                self._bytes -= len(message)
                await self._send(message)
                self._stats.bytes_sent += len(message)
                self._stats.samples_sent += is_sample
