"""The `moosdb` adapter: a MOOSDB of our own, to which pHelmIvP, uXMS, pymoos and all other MOOS programs connect."""

from __future__ import annotations

import asyncio

from uwserver.adapter import AdapterContext, Chores, Peers, Refusals, address_text, serve_tcp, serving
from uwserver_adapters.moos.clock import DatabaseClock, warp_of
from uwserver_adapters.moos.config import MoosDbConfig
from uwserver_adapters.moos.db.database import Database
from uwserver_adapters.moos.db.guests import Batch, Guest
from uwserver_adapters.moos.db.local import OWN_NAME, RIVAL, LocalClient

TELL_S = 1.0
"""Wall time between two rounds of DB_ variables."""


class MoosDbAdapter:
    """Serves the MOOS wire.

    Attributes:
        clock: MOOS time of the community.
        database: its variables.
        peers: its connections.
    """

    Config = MoosDbConfig

    def __init__(self, config: MoosDbConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.clock = DatabaseClock(warp_of(context, config.warp))
        steady, warp = asyncio.get_running_loop().time, self.clock.warp
        self.database = Database(config.community, self.clock.now, config.max_variables, lambda: steady() * warp)
        self.peers: Peers[Guest] = Peers(
            config.max_clients, Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        )
        self._chores = Chores()
        self._names: dict[str, Guest] = {}
        self._with_mail: list[Guest] = []
        self._sending: asyncio.Handle | None = None

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: see there.
            CannotServe: the table names what is not there.
        """
        config, stats = self.config, self.context.stats
        async with serve_tcp(lambda: Guest(self), self.peers, config.bind, config.port, rival=RIVAL) as server:
            world = LocalClient(config.bridge, self.context, self.database, self.clock)
            try:
                stats.details["warp"] = self.clock.warp
                address = address_text(config.bind, server.port)
                with serving(self.context, world.bridge, address, ready):
                    await self._attend(world)
            finally:
                if self._sending is not None:
                    self._sending.cancel()
                self._chores.close()
                world.close()

    async def _attend(self, world: LocalClient) -> None:
        """Tell how the database does, and end who is silent."""
        loop = asyncio.get_running_loop()
        while True:
            self.database.tell()
            world.bridge.attend()
            self.context.stats.details["refused_writes"] = self.database.refused
            await asyncio.sleep(TELL_S)
            for guest in self.peers:
                guest.check(loop.time())

    # -- for guests -----------------------------------------------------------------------------------------------------------------

    def is_free(self, name: str) -> bool:
        """Whether no other client has this name."""
        return name not in self._names and name not in (OWN_NAME, self.database.name)

    def joined(self, guest: Guest) -> None:
        """A client has said its name."""
        self._names[guest.name] = guest
        self.context.stats.peers = len(self._names)
        self.database.join(guest.name, guest.deliver)

    def left(self, guest: Guest) -> None:
        """A client is gone."""
        del self._names[guest.name]
        self._chores.add(self.database.leave(guest.name))
        self.context.stats.peers = len(self._names)

    def has_mail(self, guest: Guest) -> None:
        """It wants to send, with all others, at the end of this turn of the loop."""
        self._with_mail.append(guest)
        if self._sending is None:
            self._sending = asyncio.get_running_loop().call_soon(self._send)

    def _send(self) -> None:
        self._sending = None
        guests, self._with_mail = self._with_mail, []
        batch = Batch([])
        for guest in guests:
            batch = guest.send_mail(batch)
