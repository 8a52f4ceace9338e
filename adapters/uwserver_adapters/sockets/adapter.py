"""The `sockets` adapter: listens, and holds what all its connections share."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import logging
import os
import secrets
from typing import Annotated

from msgspec import Meta

from uwserver.adapter import AdapterContext, AdapterTable
from uwserver.table import Name, Positive
from uwserver_adapters.sockets.connection import Connection
from uwserver_adapters.sockets.fanout import Fanout

_log = logging.getLogger(__name__)

TOKEN_VARIABLE = "UWSERVER_TOKEN"
CLOSING_S = 0.2
"""Wall time in which peers may take what was written before the adapter ends."""

_Count = Annotated[int, Meta(ge=1)]


class SocketsConfig(AdapterTable, tag="sockets", kw_only=True, frozen=True):
    """Attributes:
    bind: address to listen at; anything but loopback needs a token.
    port: TCP port; 0 takes a free one.
    token: clients must show it; default: the environment's UWSERVER_TOKEN; generated and printed when bind is not loopback and there is none.
    queue_samples: samples that wait for a slow client before the oldest is dropped.
    max_requests_per_s: of one client; more are refused.
    max_clients: connected at once.
    hello_timeout_s: wall time in which a client must have shown the token.
    """

    bind: Name = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 7600
    token: Name | None = None
    queue_samples: _Count = 1024
    max_requests_per_s: _Count = 50_000
    max_clients: _Count = 256
    hello_timeout_s: Positive = 10.0


class CannotListen(Exception):
    """The address cannot be had; the text says why and what to do."""


class SocketsAdapter:
    """Serves the native wire of docs/reference/protocol.md on one TCP port.

    Attributes:
        token: what clients must show; None where none is needed.
        fanout: routes of samples and events to clients.
    """

    Config = SocketsConfig

    def __init__(self, config: SocketsConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.fanout = Fanout(context)
        self.token = config.token or os.environ.get(TOKEN_VARIABLE) or None
        self._token_is_new = self.token is None and not _is_loopback(config.bind)
        if self._token_is_new:
            self.token = secrets.token_urlsafe(24)
        self._connections: dict[Connection, None] = {}
        self._last_serial = 0
        self._all_gone = asyncio.Event()

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: see there.
        """
        stats = self.context.stats
        server = await self._listen()
        detach = self.context.attach(self.fanout)
        try:
            port = server.sockets[0].getsockname()[1]
            stats.address = f"[{self.config.bind}]:{port}" if ":" in self.config.bind else f"{self.config.bind}:{port}"
            stats.state = "running"
            if self._token_is_new:
                self._announce_token(port)
            ready.set()
            await asyncio.get_running_loop().create_future()  # until cancelled
        finally:
            detach()
            server.close()
            await self._close_connections()
            stats.state = "stopped"

    async def _listen(self) -> asyncio.Server:
        config = self.config
        try:
            return await asyncio.get_running_loop().create_server(
                lambda: Connection(self), config.bind, config.port, backlog=256
            )
        except OSError as error:
            raise CannotListen(_why(error, config)) from error

    def _announce_token(self, port: int) -> None:
        bind = self.config.bind
        host = "127.0.0.1" if bind in ("0.0.0.0", "::") else bind
        _log.warning(
            "%s listens at %s, which others can reach, and no token was set (token, or %s): one was made for this run. Connect with\n"
            "    uwclient --host %s --port %d --token %s topics",
            self.context.name, bind, TOKEN_VARIABLE, host, port, self.token,
        )  # fmt: skip

    async def _close_connections(self) -> None:
        for connection in list(self._connections):
            connection.close()
        try:
            if self._connections:
                self._all_gone.clear()
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._all_gone.wait(), CLOSING_S)
        finally:
            for connection in list(self._connections):
                connection.abort()
        if self._connections:
            self._all_gone.clear()
            await self._all_gone.wait()  # an aborted transport is gone with the next turn of the loop

    # -- for connections ------------------------------------------------------------------------------------------------------------

    def next_serial(self) -> int:
        """Number of a new client."""
        self._last_serial += 1
        return self._last_serial

    def enter(self, connection: Connection) -> bool:
        """Whether there is room for a connection. One that only listens on, and may be long dead, makes way."""
        room = len(self._connections) < self.config.max_clients
        if not room:
            idle = next((other for other in self._connections if other.is_half_open), None)
            if idle is not None:
                idle.abort()
                room = True
        self._connections[connection] = None
        self.context.stats.peers = len(self._connections)
        return room

    def leave(self, connection: Connection) -> None:
        """A connection is gone."""
        self._connections.pop(connection, None)
        self.context.stats.peers = len(self._connections)
        if not self._connections:
            self._all_gone.set()


def _is_loopback(bind: str) -> bool:
    try:
        return ipaddress.ip_address(bind).is_loopback
    except ValueError:
        return bind == "localhost"


def _why(error: OSError, config: SocketsConfig) -> str:
    where = f"{config.bind} port {config.port}"
    if error.errno == errno.EADDRINUSE:
        return (
            f"{where} is in use, perhaps by another uwserver: stop it (`ss -ltnp 'sport = :{config.port}'` names it), or give this adapter "
            "another port (port = 0 takes a free one)"
        )
    if error.errno == errno.EACCES:
        return f"{where} needs rights that this process has not: take a port above 1023"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{where}: this machine has no such address; bind = 127.0.0.1 is always there, 0.0.0.0 means all"
    return f"cannot listen at {where}: {error}"
