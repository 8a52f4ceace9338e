"""The adapter `moosdb`: a MOOSDB of our own, to which pHelmIvP, uXMS, pymoos and all other MOOS programs connect."""

from __future__ import annotations

import asyncio

from uwserver.adapter import AdapterBase, AdapterContext, address_text, serve_tcp
from uwserver_adapters.moos.config import MoosDbConfig
from uwserver_adapters.moos.db.guests import Community, Guest
from uwserver_adapters.moos.db.local import OWN_NAME, RIVAL, LocalClient


class MoosDbAdapter(AdapterBase[MoosDbConfig]):
    """Serves the MOOS wire.

    Attributes:
        community: the database and its clients.
    """

    Config = MoosDbConfig

    def __init__(self, config: MoosDbConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self.community = Community(config, context, OWN_NAME)

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: the address cannot be had.
            CannotServe: the table names what is not there.
        """
        config, context, community = self.config, self.context, self.community
        database = community.database
        async with serve_tcp(
            lambda: Guest(community), community.peers, config.bind, config.port, rival=RIVAL
        ) as server:
            world = LocalClient(config.bridge, context, database, community.clock)
            context.stats.details["warp"] = community.clock.warp

            def attend() -> None:
                context.stats.details["refused_writes"] = database.refused
                for guest in community.peers:
                    guest.check()

            try:
                await world.serve(address_text(config.bind, server.port), ready, attend)
            finally:
                community.close()
