"""The `moosdb` adapter: a MOOSDB of our own, to which pHelmIvP, uXMS, pymoos and all other MOOS programs connect."""

from __future__ import annotations

import asyncio
import errno
import logging

from uwserver.adapter import AdapterContext
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.adapter import server_warp
from uwserver_adapters.moos.alog import Alog
from uwserver_adapters.moos.bridge import Bridge, Pairs
from uwserver_adapters.moos.clock import MoosClock
from uwserver_adapters.moos.config import BridgeTable, MoosDbConfig
from uwserver_adapters.moos.database import Database, Letter
from uwserver_adapters.moos.guests import Guest
from uwserver_adapters.moos.wire import Message

_log = logging.getLogger(__name__)

OWN_NAME = "uwserver"
TELL_S = 1.0
"""Wall time between two rounds of DB_ variables."""


class CannotListen(Exception):
    """The address cannot be had; the text says why and what to do."""


def cannot_listen(error: OSError, bind: str, port: int) -> CannotListen:
    """The reason in words that say what to do."""
    where = f"{bind} TCP port {port}"
    if error.errno == errno.EADDRINUSE:
        return CannotListen(
            f"{where} is in use, perhaps by a MOOSDB: stop it, or give this adapter another port (0 takes a free one)"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return CannotListen(
            f"{where}: this machine has no such address; bind = 127.0.0.1 is always there, 0.0.0.0 means all"
        )
    return CannotListen(f"cannot listen at {where}: {error}")


class LocalClient:
    """The world as a client of a database in this process: no socket between them.

    Args:
        table: what it publishes and obeys.
        context: the world.
        database: where it is a client.
        clock: MOOS time.
    """

    def __init__(self, table: BridgeTable, context: AdapterContext, database: Database, clock: MoosClock) -> None:
        self._context = context
        self._database = database
        self._clock = clock
        self._mail: list[tuple[str, float | str | bytes, str, float]] = []
        self._waking: asyncio.Handle | None = None
        self._alog = Alog(table.alog, clock.now) if table.alog else None
        try:
            self.bridge = Bridge(table, context, self._post, OWN_NAME)
        except BaseException:
            self._end_log()
            raise
        if self._alog is not None:
            database.log = self._log
        database.join(OWN_NAME, self._deliver)
        for name in self.bridge.listens_to:
            database.register(OWN_NAME, name, 0.0)
        self.bridge.begin()

    def _post(self, pairs: Pairs) -> None:
        now = self._clock.now()
        for name, value in pairs:
            self._database.write(wire.notify(name, value, now, OWN_NAME))

    def _deliver(self, letter: Letter) -> None:
        message = letter.message
        if message.src == OWN_NAME:
            return
        self._mail.append((message.key, message.value, message.src, message.time))
        if self._waking is None:
            # What a client wrote in one packet takes effect together.
            self._waking = asyncio.get_running_loop().call_soon(self._take)

    def _take(self) -> None:
        self._waking = None
        mail, self._mail = self._mail, []
        self.bridge.take(mail)

    def _log(self, message: Message) -> None:
        if self._alog is not None:
            self._alog.write(message.time, message.key, message.src, message.value)

    def close(self) -> None:
        """Cancel calls, end the log."""
        if self._waking is not None:
            self._waking.cancel()
        self.bridge.close()
        self._end_log()

    def _end_log(self) -> None:
        if self._alog is not None:
            self._alog.close()


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

    def take(self, guest: Guest, message: Message) -> None:
        """A message of a client."""
        self.database.take(guest.name, message)

    def note(self, name: str, text: str) -> None:
        """A client was disconnected."""
        _log.warning("%s disconnects %s: %s", self.context.name, name or "a client", text)
