"""The adapter `player`: a server of Player's protocol, for clients of libplayerc and others."""

from __future__ import annotations

import asyncio
import itertools

from uwserver.adapter import (
    AdapterBase,
    CannotServe,
    Peers,
    address_text,
    serve_tcp,
    serving,
)
from uwserver_adapters.player.client import Client, Server
from uwserver_adapters.player.config import PlayerConfig


class PlayerAdapter(AdapterBase[PlayerConfig]):
    """Serves all devices on one port."""

    Config = PlayerConfig

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: the table wants ground truth without `truth = true`.
            CannotListen: the address cannot be had, or it is not loopback and the table does not allow that.
        """
        config, context = self.config, self.context
        config.check_bind("Player")
        if config.pose == "truth" and not config.truth:
            raise CannotServe('pose = "truth" needs truth = true')
        peers: Peers[Client] = Peers(config.max_clients, self.refusals, context.stats, strangers=config.max_strangers)
        server, numbers = Server(config, context, peers), itertools.count(1)

        def connected() -> Client:
            return Client(server, f"player#{next(numbers)}")

        async with serve_tcp(connected, peers, config.bind, config.port, rival="Player") as listener:
            with serving(context, server, address_text(config.bind, listener.port), ready):
                await asyncio.Event().wait()
