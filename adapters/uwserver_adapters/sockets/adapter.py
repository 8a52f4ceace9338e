"""The `sockets` adapter: listens, and closes everything in order."""

from __future__ import annotations

import asyncio
import logging
import socket

from uwserver.adapter import (
    TOKEN_VARIABLE,
    AdapterContext,
    CannotListen,
    Listener,
    Peer,
    Peers,
    address_text,
    cannot_listen,
    is_loopback,
    known_token,
    serve_tcp,
    serving,
    tls_context,
    token_for,
)
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.native.session import Allowance
from uwserver_adapters.sockets.config import SocketsConfig
from uwserver_adapters.sockets.connection import Connection
from uwserver_adapters.sockets.datagrams import RECEIVE_BUFFER, DatagramEndpoint

log = logging.getLogger(__name__)


class SocketsAdapter:
    """Serves the native wire of docs/reference/protocol.md on one TCP port, and on a UDP port if configured.

    Attributes:
        service: the native protocol.
        peers: clients of all transports.
    """

    Config = SocketsConfig

    def __init__(self, config: SocketsConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self._token = token_for(known_token(config.token), not is_loopback(config.bind))
        allowance = Allowance(config.max_subscriptions, config.max_unanswered)
        self.service = NativeService(context, self._token.text, allowance, config.max_requests_per_s)
        self.peers: Peers[Peer] = Peers(
            config.max_clients,
            self.service.refusals,
            context.stats,
            most_per_host=config.max_clients_per_host,
            strangers=config.max_strangers,
        )

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: an address cannot be had, or TLS is configured wrongly.
        """
        config = self.config
        tls = tls_context(config.tls_cert, config.tls_key, config.tls_client_ca)
        if tls is not None and config.udp_port is not None:
            text = "datagrams are not encrypted: udp_port and tls_cert do not go together"
            raise CannotListen(f'{text}; give UDP an adapter of its own ([adapters.<name>] with kind = "sockets")')

        def make() -> Connection:
            return Connection(self.service, config, self.peers)

        serving_tcp = serve_tcp(make, self.peers, config.bind, config.port, tls=tls, handshake_s=config.hello_timeout_s)
        async with serving_tcp as server:
            datagrams: asyncio.DatagramTransport | None = None
            try:
                if config.udp_port is not None:
                    datagrams = await self._listen_for_datagrams(server, config.udp_port)
                with serving(self.context, self.service.fanout, address_text(config.bind, server.port), ready):
                    if self._token.is_new:
                        self._announce_token(server.port)
                    await asyncio.get_running_loop().create_future()  # until cancelled
            finally:
                server.close()
                await self.service.fanout.close()
                if datagrams is not None:
                    await self._end_datagrams(datagrams)

    async def _listen_for_datagrams(self, server: Listener, port: int) -> asyncio.DatagramTransport:
        bind = self.config.bind
        # The address is that of TCP, for which a name was resolved.
        listener = server.sockets[0]
        host, _, *rest = listener.getsockname()
        udp = socket.socket(listener.family, socket.SOCK_DGRAM)
        try:
            udp.setblocking(False)
            udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            udp.bind((host, port, *rest))
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: DatagramEndpoint(self.service, self.config, self.peers), sock=udp
            )
        except BaseException as error:
            udp.close()
            if isinstance(error, OSError):
                raise cannot_listen(error, bind, port, "udp", key="udp_port") from error
            raise
        self.context.stats.details["udp"] = address_text(bind, transport.get_extra_info("sockname")[1])
        return transport

    async def _end_datagrams(self, transport: asyncio.DatagramTransport) -> None:
        for peer in self.peers:
            peer.close()  # before the socket, so that a last datagram can be sent
        transport.abort()
        await asyncio.sleep(0)  # the loop closes the socket in its next turn

    def _announce_token(self, port: int) -> None:
        bind = self.config.bind
        host = "127.0.0.1" if bind in ("0.0.0.0", "::") else bind
        log.warning(
            "%s listens at %s, which other machines can reach, and no token is set (token, or %s): one was made for this run. Connect with\n"
            "    uwclient --host %s --port %d --token %s topics",
            self.context.name, bind, TOKEN_VARIABLE, host, port, self._token.text,
        )  # fmt: skip
