"""The adapter `player`: a server of Player's protocol, for clients of libplayerc and others."""

from __future__ import annotations

import asyncio

from uwserver.adapter import (
    AdapterContext,
    CannotListen,
    CannotServe,
    Peers,
    Refusals,
    address_text,
    is_loopback,
    serve_tcp,
    serving,
)
from uwserver_adapters.player.client import Client, Server
from uwserver_adapters.player.config import PlayerConfig


class PlayerAdapter:
    """Serves all devices on one port."""

    Config = PlayerConfig

    def __init__(self, config: PlayerConfig, context: AdapterContext) -> None:
        self.config, self.context = config, context
        self._count = 0

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: the table wants ground truth without `truth = true`.
            CannotListen: the address cannot be had, or it is not loopback and the table does not allow that.
        """
        config, context = self.config, self.context
        if not (is_loopback(config.bind) or config.allow_network):
            text = f"Player knows no token: whoever reaches {config.bind} could read and command all"
            raise CannotListen(f"{text}. Say allow_network = true if that is wanted")
        if config.pose == "truth" and not config.truth:
            raise CannotServe('pose = "truth" needs truth = true')
        refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        peers: Peers[Client] = Peers(config.max_clients, refusals, context.stats, strangers=config.max_strangers)
        server = Server(config, context, peers)

        def connected() -> Client:
            self._count += 1
            return Client(server, f"player#{self._count}")

        async with serve_tcp(connected, peers, config.bind, config.port, rival="Player") as listener:
            with serving(context, server, address_text(config.bind, listener.port), ready):
                await asyncio.Event().wait()
