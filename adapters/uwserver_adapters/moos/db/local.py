"""The world as a client of a database in the same process, for the two adapters that listen."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence

from uwserver.adapter import AdapterContext, BackgroundWork, serving
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.alog import Alog
from uwserver_adapters.moos.bridge.bridge import Bridge, Pairs
from uwserver_adapters.moos.clock import DatabaseClock
from uwserver_adapters.moos.config import BridgeTable
from uwserver_adapters.moos.db.database import Database
from uwserver_adapters.moos.db.variable import Letter

OWN_NAME = "uwserver"
RIVAL = "a MOOSDB"
"""The program that most likely holds a port that is in use."""
TELL_S = 1.0
"""Wall time between two rounds of DB_ variables."""
AT_ONCE = 256
"""Most writes that take effect together. After them others may have their turn."""


class LocalClient:
    """The world as a client of a database, with no socket between them.

    Args:
        table: what the bridge publishes and obeys.
        context: the world.
        database: the database.
        clock: MOOS time.

    Attributes:
        bridge: the bridge between the database and the world.
    """

    def __init__(self, table: BridgeTable, context: AdapterContext, database: Database, clock: DatabaseClock) -> None:
        self._context = context
        self._database = database
        self._clock = clock
        self._mail: list[tuple[str, float | str | bytes, str, float]] = []
        self._background = BackgroundWork()
        steady = asyncio.get_running_loop().time
        self.bridge = Bridge(table, context, self._post, self._listen, OWN_NAME, steady)
        # The log comes after the bridge: a table that does not fit is tried again and again, and should leave no file each time.
        alog = self._alog = Alog(table.alog, clock.now, context) if table.alog else None
        if alog is not None:
            database.log = lambda message: alog.add(message.time, message.key, message.src, message.value)
        database.join(OWN_NAME, self._deliver)
        self._listen(self.bridge.listens_to)
        self.bridge.begin(database.community)

    async def serve(self, address: str, ready: asyncio.Event, attend: Callable[[], object]) -> None:
        """Publish and obey until cancelled; then cancel all calls, and end the log.

        Args:
            address: where peers find the adapter.
            ready: as `Adapter.run` got it.
            attend: called each second.
        """
        try:
            with serving(self._context, self.bridge, address, ready):
                while True:
                    self._database.tell()
                    self.bridge.attend()
                    attend()
                    await asyncio.sleep(TELL_S)
        finally:
            self._background.close()
            self.bridge.close()
            if self._alog is not None:
                self._alog.close()

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
        if not self._background:
            # In the next turn of the loop: writes of one packet take effect together.
            self._background.add(self._take())

    def _take(self) -> Iterator[None]:
        while self._mail:
            mail = self._mail[:AT_ONCE]
            del self._mail[:AT_ONCE]
            self.bridge.take(mail)
            yield
