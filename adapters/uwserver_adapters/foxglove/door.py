"""Connections whose handshake is not over: there are few places for them, and the oldest is closed first."""

from __future__ import annotations

import asyncio

from websockets.asyncio.server import ServerConnection

from uwserver.adapter import STRANGERS, Refusals


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
