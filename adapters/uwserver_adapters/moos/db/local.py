"""The world as a client of a database in the same process, and what the two adapters that listen share."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from uwserver.adapter import TURN_S, AdapterContext
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.alog import Alog
from uwserver_adapters.moos.bridge.bridge import Bridge, Pairs
from uwserver_adapters.moos.clock import DatabaseClock
from uwserver_adapters.moos.config import BridgeTable
from uwserver_adapters.moos.db.database import Database
from uwserver_adapters.moos.db.variable import Letter
from uwserver_adapters.moos.wire import Message

OWN_NAME = "uwserver"
RIVAL = "a MOOSDB"
"""Who most likely holds a port that is in use."""
AT_ONCE = 256
"""Writes that take effect together; behind so many of them others may have their turn."""
REST_S = 0.004
"""Wall time before the next of them, once a turn is used up."""


class LocalClient:
    """The world as a client of a database in this process: no socket between them.

    Args:
        table: what it publishes and obeys.
        context: the world.
        database: where it is a client.
        clock: MOOS time.
    """

    def __init__(self, table: BridgeTable, context: AdapterContext, database: Database, clock: DatabaseClock) -> None:
        self._context = context
        self._database = database
        self._clock = clock
        self._mail: list[tuple[str, float | str | bytes, str, float]] = []
        self._waking: asyncio.Handle | None = None
        self._loop = asyncio.get_running_loop()
        self.bridge = Bridge(table, context, self._post, self._listen, OWN_NAME, self._loop.time)
        # After the bridge: a table that does not fit makes no file at each try.
        self._alog = Alog(table.alog, clock.now, context) if table.alog else None
        if self._alog is not None:
            database.log = self._log
        database.join(OWN_NAME, self._deliver)
        self._listen(self.bridge.listens_to)
        self.bridge.begin(database.community)

    def _post(self, pairs: Pairs) -> None:
        now = self._clock.now()
        for name, value in pairs:
            self._database.write(wire.notify(name, value, now, OWN_NAME))

    def _listen(self, names: Sequence[str]) -> None:
        for name in names:
            self._database.register(OWN_NAME, name, 0.0)

    def _deliver(self, letter: Letter) -> None:
        message = letter.message
        if message.src == OWN_NAME:
            return
        self._mail.append((message.key, message.value, message.src, message.time))
        if self._waking is None:
            # What a client wrote in one packet takes effect together.
            self._waking = self._loop.call_soon(self._take)

    def _take(self) -> None:
        """Take what is there, for one turn; what is left has its own, after a rest."""
        self._waking = None
        end = self._loop.time() + TURN_S
        at = 0
        while at < len(self._mail):
            if at and self._loop.time() >= end:
                self._waking = self._loop.call_later(REST_S, self._take)
                break
            mail = self._mail[at : at + AT_ONCE]
            at += len(mail)
            self.bridge.take(mail)
        del self._mail[:at]

    def _log(self, message: Message) -> None:
        if self._alog is not None:
            self._alog.write(message.time, message.key, message.src, message.value)

    def close(self) -> None:
        """Cancel calls, end the log."""
        if self._waking is not None:
            self._waking.cancel()
        self.bridge.close()
        if self._alog is not None:
            self._alog.close()
