"""The `rosbridge` adapter: listens, and closes everything in order. The ROS message types are loaded only when it runs."""

from __future__ import annotations

import asyncio
import itertools
import logging
from typing import TYPE_CHECKING

from uwserver.adapter import (
    TOKEN_VARIABLE,
    AdapterContext,
    Peer,
    Peers,
    Refusals,
    address_text,
    is_loopback,
    known_token,
    serve_tcp,
    serving,
    tls_context,
    token_for,
)
from uwserver_adapters.rosbridge.config import RosbridgeConfig

if TYPE_CHECKING:
    from uwserver_adapters.native.outbox import Outbox

log = logging.getLogger(__name__)


class RosbridgeAdapter:
    """Serves rosbridge v2 on one TCP port.

    Attributes:
        peers: all connections.
    """

    Config = RosbridgeConfig

    def __init__(self, config: RosbridgeConfig, context: AdapterContext) -> None:
        self.config, self.context = config, context
        self._token = token_for(known_token(config.token), not is_loopback(config.bind))
        self._refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        self.peers: Peers[Peer] = Peers(
            config.max_clients, self._refusals, context.stats, strangers=config.max_strangers
        )
        self._serials = itertools.count(1)

    @property
    def token(self) -> str | None:
        """The token that clients must show; None where none is needed."""
        return self._token.text

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: rosbags is not installed.
            CannotListen: the address cannot be had, or TLS is configured wrongly.
        """
        from uwserver_adapters.native.limits import Lockout
        from uwserver_adapters.rosbridge.connection import RosbridgeConnection
        from uwserver_adapters.rosbridge.hub import Hub
        from uwserver_adapters.rosbridge.rosapi import Rosapi
        from uwserver_adapters.rosbridge.session import Session

        config = self.config
        hub = Hub(self.context, config, self._refusals)
        hub.feed.begin()
        rosapi, lockout = Rosapi(hub), Lockout()

        def begin(outbox: Outbox, wake: object) -> Session:
            return Session(hub, rosapi, outbox, wake, next(self._serials))  # type: ignore[arg-type]

        def greet() -> RosbridgeConnection:
            return RosbridgeConnection(hub, self.token, lockout, self.peers, begin)

        tls = tls_context(config.tls_cert, config.tls_key, config.tls_client_ca)
        listening = serve_tcp(greet, self.peers, config.bind, config.port, tls=tls, handshake_s=config.hello_timeout_s)
        async with listening as server:
            scheme = "ws" if tls is None else "wss"
            address = f"{scheme}://{address_text(config.bind, server.port)}"
            try:
                with serving(self.context, hub, address, ready):
                    if self._token.is_new:
                        log.warning(
                            "%s listens at %s, which other machines can reach, and no token is set (token, or %s): one was made for this run."
                            " Connect to\n    %s/?token=%s",
                            self.context.name, config.bind, TOKEN_VARIABLE, address, self.token,
                        )  # fmt: skip
                    await asyncio.get_running_loop().create_future()  # until cancelled
            finally:
                server.close()
                await hub.feed.close()
