"""The `rosbridge` adapter: listens, and closes everything in order. The ROS message types are loaded only when it runs."""

from __future__ import annotations

import asyncio
import itertools
from typing import TYPE_CHECKING

from uwserver.adapter import (
    AdapterBase,
    AdapterContext,
    Lockout,
    Peer,
    Peers,
    address_text,
    is_loopback,
    known_token,
    serve_tcp,
    serving,
    token_for,
)
from uwserver_adapters.rosbridge.config import RosbridgeConfig

if TYPE_CHECKING:
    from uwserver_adapters.native.outbox import Outbox


class RosbridgeAdapter(AdapterBase[RosbridgeConfig]):
    """Serves rosbridge v2 on one TCP port.

    Attributes:
        peers: all connections.
    """

    Config = RosbridgeConfig

    def __init__(self, config: RosbridgeConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self._token = token_for(known_token(config.token), not is_loopback(config.bind))
        self.peers: Peers[Peer] = Peers(
            config.max_clients, self.refusals, context.stats, strangers=config.max_strangers
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
        from uwserver_adapters.rosbridge.connection import RosbridgeConnection
        from uwserver_adapters.rosbridge.hub import Hub
        from uwserver_adapters.rosbridge.rosapi import Rosapi
        from uwserver_adapters.rosbridge.session import Session

        config = self.config
        hub = Hub(self.context, config, self.refusals)
        hub.feed.begin()
        rosapi, lockout = Rosapi(hub), Lockout()

        def begin(outbox: Outbox, wake: object) -> Session:
            return Session(hub, rosapi, outbox, wake, next(self._serials))  # type: ignore[arg-type]

        def greet() -> RosbridgeConnection:
            return RosbridgeConnection(hub, self.token, lockout, self.peers, begin)

        tls = config.tls()
        listening = serve_tcp(greet, self.peers, config.bind, config.port, tls=tls, handshake_s=config.hello_timeout_s)
        async with listening as server:
            scheme = "ws" if tls is None else "wss"
            address = f"{scheme}://{address_text(config.bind, server.port)}"
            try:
                with serving(self.context, hub, address, ready):
                    reason = f"listens at {config.bind}, which other machines can reach"
                    self._token.announce(self.context, reason, f"Connect to\n    {address}/?token={self.token}")
                    await asyncio.get_running_loop().create_future()  # until cancelled
            finally:
                server.close()
                await hub.feed.close()
