"""The `moosdb` adapter: a MOOSDB of our own, to which pHelmIvP, uXMS, pymoos and all other MOOS programs connect."""

from __future__ import annotations

import asyncio

from uwserver.adapter import AdapterContext
from uwserver_adapters.moos.client.adapter import server_warp
from uwserver_adapters.moos.clock import MoosClock
from uwserver_adapters.moos.config import MoosDbConfig
from uwserver_adapters.moos.db.database import Database
from uwserver_adapters.moos.db.guests import Batch, Guest
from uwserver_adapters.moos.db.local import OWN_NAME, LocalClient, cannot_listen

TELL_S = 1.0
"""Wall time between two rounds of DB_ variables."""


class MoosDbAdapter:
    """Serves the MOOS wire.

    Attributes:
        clock: MOOS time of the community.
        database: its variables.
    """

    Config = MoosDbConfig

    def __init__(self, config: MoosDbConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.clock = MoosClock(server_warp(context, config.warp, context.name), asyncio.get_running_loop().time)
        self.database = Database(config.community, self.clock.now, config.max_variables)
        self._guests: dict[Guest, None] = {}
        self._names: dict[str, Guest] = {}
        self._with_mail: list[Guest] = []
        self._sending: asyncio.Handle | None = None

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: see there.
            CannotServe: the table names what is not there.
        """
        config, stats, loop = self.config, self.context.stats, asyncio.get_running_loop()
        try:
            server = await loop.create_server(lambda: Guest(self), config.bind, config.port, backlog=256)
        except OSError as error:
            raise cannot_listen(error, config.bind, config.port) from error
        world: LocalClient | None = None
        detach = None
        try:
            world = LocalClient(config.bridge, self.context, self.database, self.clock)
            detach = self.context.attach(world.bridge)
            host = f"[{config.bind}]" if ":" in config.bind else config.bind
            stats.address = f"{host}:{server.sockets[0].getsockname()[1]}"
            stats.details["warp"] = self.clock.warp
            stats.state = "running"
            ready.set()
            while True:
                self.database.tell()
                stats.details["refused"] = self.database.refused
                await asyncio.sleep(TELL_S)
                for guest in list(self._guests):
                    guest.check(loop.time())
        finally:
            if detach is not None:
                detach()
            server.close()
            for guest in list(self._guests):
                guest.abort()
            if self._sending is not None:
                self._sending.cancel()
            if world is not None:
                world.close()
            await asyncio.sleep(0)  # aborted connections are gone with the next turn of the loop
            stats.state = "stopped"

    # -- for guests -----------------------------------------------------------------------------------------------------------------

    def enter(self, guest: Guest) -> bool:
        """Whether there is room."""
        room = len(self._guests) < self.config.max_clients
        self._guests[guest] = None
        return room

    def exit(self, guest: Guest) -> None:
        """A connection is gone."""
        self._guests.pop(guest, None)
        if self._names.get(guest.name) is guest:
            del self._names[guest.name]
            self.database.leave(guest.name)
            self.context.stats.peers = len(self._names)

    def is_free(self, name: str) -> bool:
        """Whether no other client has this name."""
        return name not in self._names and name not in (OWN_NAME, self.database.name)

    def joined(self, guest: Guest) -> None:
        """A client has said its name."""
        self._names[guest.name] = guest
        self.context.stats.peers = len(self._names)
        self.database.join(guest.name, guest.deliver)

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
