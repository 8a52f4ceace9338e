"""The `sockets` adapter: listens, and closes everything in order."""

from __future__ import annotations

import asyncio
import socket

from uwserver.adapter import (
    AdapterBase,
    AdapterContext,
    CannotListen,
    Peer,
    Peers,
    TcpListener,
    address_text,
    cannot_listen,
    host_here,
    is_loopback,
    known_token,
    serve_tcp,
    serving,
    token_for,
)
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.native.session import Allowance
from uwserver_adapters.sockets.connection import Connection, SocketsConfig
from uwserver_adapters.sockets.datagrams import RECEIVE_BUFFER, DatagramEndpoint


class SocketsAdapter(AdapterBase[SocketsConfig]):
    """Serves the native wire of docs/reference/protocol.md on one TCP port, and on a UDP port if configured.

    Attributes:
        service: the native protocol.
        peers: clients of all transports.
    """

    Config = SocketsConfig

    def __init__(self, config: SocketsConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self._token = token_for(known_token(config.token), not is_loopback(config.bind))
        allowance = Allowance(config.max_subscriptions, config.max_unanswered)
        self.service = NativeService(context, self._token.text, allowance, config.max_requests_per_s, self.refusals)
        self.peers: Peers[Peer] = Peers(
            config.max_clients,
            self.refusals,
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
        tls = config.tls()
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
                    command = f"uwclient --host {host_here(config.bind)} --port {server.port} --token {self._token.text} topics"
                    reason = f"listens at {config.bind}, which other machines can reach"
                    self._token.announce(self.context, reason, f"Connect with\n    {command}")
                    await asyncio.get_running_loop().create_future()  # until cancelled
            finally:
                server.close()
                await self.service.fanout.close()
                if datagrams is not None:
                    await self._end_datagrams(datagrams)

    async def _listen_for_datagrams(self, server: TcpListener, port: int) -> asyncio.DatagramTransport:
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
