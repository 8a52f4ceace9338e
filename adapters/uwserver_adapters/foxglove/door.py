"""Connections that have not shown yet that they are viewers: they have few places, and the oldest makes way."""

from __future__ import annotations

import asyncio

from websockets.asyncio.server import ServerConnection

from uwserver.adapter import STRANGERS, Refusals


class Door:
    """Counts the connections whose handshake is not over. Loop thread.

    Args:
        refusals: where it is told who made way.
    """

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self._waiting: dict[ServerConnection, None] = {}

    def connections(self) -> type[ServerConnection]:
        """The kind that `websockets.asyncio.server.serve` makes of each that knocks."""
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
        """It is a viewer, or gone."""
        self._waiting.pop(connection, None)
