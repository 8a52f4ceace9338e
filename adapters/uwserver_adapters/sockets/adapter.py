"""The `sockets` adapter: listens, and holds what all its connections share."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import secrets
import socket
import ssl
from typing import Annotated, Protocol

from msgspec import Meta

from uwserver.adapter import AdapterContext, AdapterTable
from uwserver.table import Name, Positive
from uwserver_adapters.sockets.connection import Connection
from uwserver_adapters.sockets.datagrams import RECEIVE_BUFFER, DatagramEndpoint
from uwserver_adapters.sockets.doorway import Doorway
from uwserver_adapters.sockets.fanout import Fanout
from uwserver_adapters.sockets.limits import Refusals
from uwserver_adapters.sockets.listening import CannotListen, is_loopback, tls_context, why, written
from uwserver_adapters.sockets.outbox import QUEUE_BYTES
from uwserver_adapters.sockets.session import SUBSCRIPTIONS, UNANSWERED, Allowance
from uwserver_adapters.sockets.websocket import LOCAL_ORIGINS

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
    udp_port: UDP port; 0 takes a free one; none by default.
    udp_lease_s: wall time after which a UDP client that says nothing is forgotten.
    allowed_origins: pages of browsers that may connect by WebSocket: an origin, one with ":*" for any port, or "*" for all.
    tls_cert: certificate (PEM); with it, TCP and WebSocket are served over TLS only. A relative path starts from the folder in which the
        server was started, as do the next two.
    tls_key: its key (PEM); default: in the file of the certificate.
    tls_client_ca: authorities (PEM) of client certificates, which are then required.
    queue_samples: samples that wait for a slow client before the oldest is dropped.
    queue_bytes: of samples, and of replies, that wait for a slow client.
    max_requests_per_s: of one client; more are refused.
    max_subscriptions: of one client.
    max_unanswered: commands and calls of one client that wait for the world.
    max_clients: connected at once.
    hello_timeout_s: wall time in which a client must have shown the token, and ended a TLS or WebSocket handshake.
    """

    bind: Name = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 7600
    token: Name | None = None
    udp_port: Annotated[int, Meta(ge=0, le=65535)] | None = None
    udp_lease_s: Positive = 10.0
    allowed_origins: tuple[Name, ...] = LOCAL_ORIGINS
    tls_cert: Name | None = None
    tls_key: Name | None = None
    tls_client_ca: Name | None = None
    queue_samples: _Count = 1024
    queue_bytes: _Count = QUEUE_BYTES
    max_requests_per_s: _Count = 50_000
    max_subscriptions: _Count = SUBSCRIPTIONS
    max_unanswered: _Count = UNANSWERED
    max_clients: _Count = 256
    hello_timeout_s: Positive = 10.0


class Peer(Protocol):
    """A client of any transport, as the adapter counts and ends it.

    Attributes:
        is_half_open: it only listens on, and may be long dead.
    """

    is_half_open: bool

    def close(self) -> None:
        """Send what it still takes, then end it."""

    def abort(self) -> None:
        """End it at once."""


class SocketsAdapter:
    """Serves the native wire of docs/reference/protocol.md on one TCP port, and on a UDP port if configured.

    Attributes:
        allowance: what one client may hold.
        refusals: counts what was refused.
        handshakes: of TLS, under way.
        token: what clients must show; None where none is needed.
        fanout: routes of samples and events to clients.
    """

    Config = SocketsConfig

    def __init__(self, config: SocketsConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.fanout = Fanout(context)
        self.token = config.token or os.environ.get(TOKEN_VARIABLE) or None
        self._token_is_new = self.token is None and not is_loopback(config.bind)
        if self._token_is_new:
            self.token = secrets.token_urlsafe(24)
        self.allowance = Allowance(config.max_subscriptions, config.max_unanswered)
        self.refusals = Refusals(context.name, context.stats)
        self.handshakes: set[asyncio.Task[None]] = set()
        self._connections: dict[Peer, None] = {}
        self._last_serial = 0
        self._all_gone = asyncio.Event()

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: see there.
        """
        stats = self.context.stats
        server = await self._listen(self._tls())
        datagrams: asyncio.DatagramTransport | None = None
        detach = self.context.attach(self.fanout)
        try:
            datagrams = await self._listen_for_datagrams(server)
            port = server.sockets[0].getsockname()[1]
            stats.address = written(self.config.bind, port)
            stats.state = "running"
            if self._token_is_new:
                self._announce_token(port)
            ready.set()
            await asyncio.get_running_loop().create_future()  # until cancelled
        finally:
            detach()
            server.close()
            try:
                await self._close_connections()
            finally:
                if datagrams is not None:
                    datagrams.abort()
                    await asyncio.sleep(0)  # its socket is closed with the next turn of the loop
                stats.state = "stopped"

    def _tls(self) -> ssl.SSLContext | None:
        config = self.config
        context = tls_context(config.tls_cert, config.tls_key, config.tls_client_ca)
        if context is not None and config.udp_port is not None:
            text = "datagrams are not encrypted: udp_port and tls_cert do not go together"
            raise CannotListen(f'{text}; give UDP an adapter of its own ([adapters.<name>] with kind = "sockets")')
        return context

    async def _listen(self, context: ssl.SSLContext | None) -> asyncio.Server:
        config = self.config

        def greet() -> asyncio.Protocol:
            return Connection(self) if context is None else Doorway(self, context)

        try:
            return await asyncio.get_running_loop().create_server(greet, config.bind, config.port, backlog=256)
        except OSError as error:
            raise CannotListen(why(error, config.bind, config.port, "tcp")) from error

    async def _listen_for_datagrams(self, server: asyncio.Server) -> asyncio.DatagramTransport | None:
        bind, port = self.config.bind, self.config.udp_port
        if port is None:
            return None
        # The same address as for TCP: where bind is a name, it was resolved there.
        listener = server.sockets[0]
        host, _, *rest = listener.getsockname()
        udp = socket.socket(listener.family, socket.SOCK_DGRAM)
        try:
            udp.setblocking(False)
            udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            udp.bind((host, port, *rest))
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: DatagramEndpoint(self), sock=udp
            )
        except BaseException as error:
            udp.close()
            if isinstance(error, OSError):
                raise CannotListen(why(error, bind, port, "udp")) from error
            raise
        self.context.stats.details["udp"] = written(bind, transport.get_extra_info("sockname")[1])
        return transport

    def _announce_token(self, port: int) -> None:
        bind = self.config.bind
        host = "127.0.0.1" if bind in ("0.0.0.0", "::") else bind
        _log.warning(
            "%s listens at %s, which others can reach, and no token was set (token, or %s): one was made for this run. Connect with\n"
            "    uwclient --host %s --port %d --token %s topics",
            self.context.name, bind, TOKEN_VARIABLE, host, port, self.token,
        )  # fmt: skip

    async def _close_connections(self) -> None:
        for handshake in list(self.handshakes):
            handshake.cancel()
        for connection in list(self._connections):
            connection.close()
        try:
            await asyncio.gather(*self.handshakes, return_exceptions=True)
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

    def enter(self, connection: Peer) -> bool:
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

    def leave(self, connection: Peer) -> None:
        """A connection is gone."""
        self._connections.pop(connection, None)
        self.context.stats.peers = len(self._connections)
        if not self._connections:
            self._all_gone.set()
