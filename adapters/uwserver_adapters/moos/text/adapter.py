"""The `moos_text` adapter: MOOS variables as lines of text on TCP and on a serial line."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import msgspec

from uwserver.adapter import (
    HIGH_WATER,
    AdapterContext,
    Chores,
    Connection,
    Peers,
    Refusals,
    address_text,
    serve_tcp,
    serving,
)
from uwserver.ports import Fault
from uwserver_adapters.moos.bridge.bridge import ERROR
from uwserver_adapters.moos.clock import DatabaseClock
from uwserver_adapters.moos.config import MoosTextConfig
from uwserver_adapters.moos.db.database import Database
from uwserver_adapters.moos.db.local import OWN_NAME, RIVAL, LocalClient
from uwserver_adapters.moos.db.variable import Letter
from uwserver_adapters.moos.text.lines import LineDecoder, Malformed, error_line
from uwserver_adapters.moos.text.serial_line import SerialLine
from uwserver_adapters.moos.text.session import TextSession

TELL_S = 1.0
UNREAD_S = 0.01
"""Wall time before a listing goes on whose user had not read what was sent."""


class TextConnection(Connection):
    """One user on TCP.

    Args:
        adapter: database and world.
    """

    def __init__(self, adapter: MoosTextAdapter) -> None:
        super().__init__(adapter.peers, adapter.config.first_line_s)
        self._adapter = adapter
        self._decoder = LineDecoder(adapter.config.line_bytes)
        self._session: TextSession | None = None
        self._steps: Iterator[None] | None = None
        self._lines: list[str] = []
        self._flushing: asyncio.Handle | None = None

    def opened(self) -> None:
        """A user is there."""
        self._session = TextSession(self._adapter, self._adapter.next_name(), self._send, self.close)

    def refused(self, fault: Fault) -> bytes:
        """The text that one user too many gets, or one that said nothing."""
        return f"{error_line('', fault.code, fault.text)}\n".encode()

    def closed(self) -> None:
        """The user went, or we closed."""
        if self._flushing is not None:
            self._flushing.cancel()
        if self._session is not None:
            self._session.close()

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._decoder.receive(data)

    def step(self) -> bool:
        """Carry out the next line, or the next piece of one; none as long as the user does not read what came of it."""
        if self._is_full:
            return False
        if self._steps is None:
            event = self._decoder.next_event()
            if event is None or self._session is None:
                return False
            if not isinstance(event, Malformed) and not self.admit():
                return False
            self._steps = self._session.take(event)
        for _ in self._steps:
            return True
        self._steps = None
        return True

    @property
    def _is_full(self) -> bool:
        """Whether so much waits for a user whose line is being carried out that the rest has to wait too."""
        return self._steps is not None and self.waiting > min(HIGH_WATER, self._adapter.config.queue_bytes // 2)

    def quiet_until(self) -> float:
        """When the rest of a line is tried again."""
        return self.loop.time() + UNREAD_S if self._is_full else 0.0

    @property
    def is_owed(self) -> bool:
        """Whether lines may still come for who sends nothing more (``echo LIST | nc -N``)."""
        return bool(self._lines) or (self._session is not None and self._session.is_owed)

    def close(self) -> None:
        """Send what is there, then close."""
        self._flush()
        super().close()

    def _send(self, line: str) -> None:
        self._lines.append(line)
        if self._flushing is None and not self.is_closing:
            self._flushing = self.loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._flushing = None
        if self.is_closing or not self._lines:
            return
        stats = self._adapter.context.stats
        if self.waiting > self._adapter.config.queue_bytes:
            stats.dropped += len(self._lines)
            stats.last_error = "a user of the text bridge read too slowly and was disconnected"
            self.abort()
            return
        data = ("\n".join(self._lines) + "\n").encode("utf-8", "replace")
        self._lines.clear()
        stats.bytes_sent += len(data)
        self.write(data)
        self.finish_if_done()


class MoosTextAdapter:
    """Serves lines of text.

    Attributes:
        clock: time of the variables, s since 1970.
        database: the variables.
        peers: users on TCP.
    """

    Config = MoosTextConfig

    def __init__(self, config: MoosTextConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.clock = DatabaseClock(1.0)
        self.database = Database("text", self.clock.now, config.max_variables, asyncio.get_running_loop().time)
        self.peers: Peers[TextConnection] = Peers(
            config.max_clients, Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        )
        self._chores = Chores()
        self._sessions: dict[str, TextSession] = {}
        self._last_number = 0

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: see there.
            CannotServe: the table names what is not there.
        """
        config = self.config
        line = SerialLine(config.serial, self) if config.serial else None
        async with serve_tcp(lambda: TextConnection(self), self.peers, config.bind, config.port, rival=RIVAL) as server:
            world = LocalClient(config.bridge, self.context, self.database, self.clock)
            try:
                self.database.join(f"{OWN_NAME}_errors", self._tell_error)
                self.database.register(f"{OWN_NAME}_errors", ERROR, 0.0)
                address = address_text(config.bind, server.port)
                with serving(self.context, world.bridge, address, ready):
                    while True:
                        self.database.tell()
                        world.bridge.attend()
                        if line is not None:
                            line.attend()
                        await asyncio.sleep(TELL_S)
            finally:
                if line is not None:
                    line.close()
                self._chores.close()
                world.close()

    def _tell_error(self, letter: Letter) -> None:
        """A refusal of the world goes to who asked for it."""
        said = msgspec.json.decode(letter.message.data)
        session = self._sessions.get(said["src"])
        if session is not None:
            session.refuse(said["code"], f"{said['variable']}: {said['message']}")

    # -- for connections and sessions -----------------------------------------------------------------------------------------------

    def next_name(self) -> str:
        """Name of a new user."""
        self._last_number += 1
        return f"text{self._last_number}"

    def joined(self, session: TextSession) -> None:
        """A user is there."""
        self._sessions[session.name] = session
        self.database.join(session.name, session.deliver)
        self.context.stats.peers = len(self._sessions)

    def left(self, session: TextSession) -> None:
        """A user went."""
        del self._sessions[session.name]
        self._chores.add(self.database.leave(session.name))
        self.context.stats.peers = len(self._sessions)
