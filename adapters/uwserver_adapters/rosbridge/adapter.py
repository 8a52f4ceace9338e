"""The `rosbridge` adapter: listens, and ends in order. The messages of ROS are loaded when it runs."""

from __future__ import annotations

import asyncio
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
    from uwserver_adapters.rosbridge.hub import Hub

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
        self._last_serial = 0

    @property
    def token(self) -> str | None:
        """That clients must show; None where none is needed."""
        return self._token.text

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: rosbags is not installed.
            CannotListen: see there.
        """
        from uwserver_adapters.native.limits import Lockout
        from uwserver_adapters.rosbridge.connection import RosbridgeConnection
        from uwserver_adapters.rosbridge.hub import Hub
        from uwserver_adapters.rosbridge.rosapi import Rosapi
        from uwserver_adapters.rosbridge.session import Session

        config = self.config
        hub = Hub(self.context, config, self._refusals)
        hub.feed.begin()
        rosapi, lockout = Rosapi(hub, lambda: self._time(hub)), Lockout()

        def begin(outbox: Outbox, wake: object) -> Session:
            self._last_serial += 1
            return Session(hub, rosapi, outbox, wake, self._last_serial)  # type: ignore[arg-type]

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
                            "%s listens at %s, which others can reach, and no token was set (token, or %s): one was made for this run."
                            " Connect to\n    %s/?token=%s",
                            self.context.name, config.bind, TOKEN_VARIABLE, address, self.token,
                        )  # fmt: skip
                    await asyncio.get_running_loop().create_future()  # until cancelled
            finally:
                server.close()
                await hub.feed.close()

    def _time(self, hub: Hub) -> int:
        """Simulation time since its epoch, ns: asked of the world, as nobody may hear of a sensor now."""
        told: list[int] = []
        self.context.call("world/status", {}, self.context.name, lambda reply: told.append(_t_ns(reply)))
        return hub.feed.catalogue.facts.epoch_ns + (told[0] if told else hub.feed.t_ns)


def _t_ns(reply: object) -> int:
    result = getattr(reply, "result", None)
    if isinstance(result, dict) and isinstance(result.get("t_ns"), int):
        return int(result["t_ns"])
    return int(getattr(reply, "t_ns", 0))
