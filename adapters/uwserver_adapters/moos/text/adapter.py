"""The `moos_text` adapter: MOOS variables as lines of text on TCP and on a serial line."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import cast

import msgspec

from uwserver.adapter import AdapterContext
from uwserver_adapters.moos.bridge.bridge import ERROR
from uwserver_adapters.moos.bridge.calls import Answer
from uwserver_adapters.moos.clock import MoosClock
from uwserver_adapters.moos.config import MoosTextConfig
from uwserver_adapters.moos.db.database import Database, Letter
from uwserver_adapters.moos.db.local import OWN_NAME, LocalClient, cannot_listen
from uwserver_adapters.moos.text.lines import NEED_DATA, LineDecoder
from uwserver_adapters.moos.text.serial_line import SerialLine
from uwserver_adapters.moos.text.session import TextSession

_log = logging.getLogger(__name__)

TELL_S = 1.0
TURN_S = 0.002
"""Wall time after which other users have their turn."""
LINGER_S = 1.0
"""Wall time that a peer has to read the last line."""


class TextConnection(asyncio.Protocol):
    """One user on TCP; all its methods run on the loop."""

    def __init__(self, adapter: MoosTextAdapter) -> None:
        self._adapter = adapter
        self._loop = asyncio.get_running_loop()
        self._decoder = LineDecoder(adapter.config.line_bytes)
        self._transport: asyncio.Transport
        self._session: TextSession | None = None
        self._lines: list[str] = []
        self._flushing: asyncio.Handle | None = None
        self._turn: asyncio.Handle | None = None
        self._linger: asyncio.TimerHandle | None = None
        self._is_closed = False
        self._is_half_open = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; one too many is told and sent away."""
        self._transport = cast(asyncio.Transport, transport)
        if self._adapter.enter(self):
            self._session = TextSession(self._adapter, self._adapter.next_name(), self._send, self._end)
        else:
            self._transport.write(b"ERROR overload too many users are connected: close some, or raise max_clients\n")
            self._end()

    def connection_lost(self, error: Exception | None) -> None:
        """The user went, or we closed."""
        self._is_closed = True
        for handle in (self._flushing, self._turn, self._linger):
            if handle is not None:
                handle.cancel()
        if self._session is not None:
            self._session.close()
        self._adapter.exit(self)

    def data_received(self, data: bytes) -> None:
        """Take bytes in pieces of any size."""
        if not self._is_closed:
            self._decoder.receive(data)
            if self._turn is None:
                self._work()

    def eof_received(self) -> bool:
        """The user sends nothing more, but may still read (``echo LIST | nc -N``).

        Returns:
            Whether the connection stays open.
        """
        self._is_half_open = True
        self._flush()
        return not self._is_closed and self._session is not None and self._session.is_owed

    def _work(self) -> None:
        self._turn = None
        end = self._loop.time() + TURN_S
        while not self._is_closed and (event := self._decoder.next_event()) is not NEED_DATA:
            assert self._session is not None
            self._session.take(event)
            if self._loop.time() > end:
                self._transport.pause_reading()
                self._turn = self._loop.call_soon(self._work)
                return
        if not self._is_closed:
            self._transport.resume_reading()

    def _send(self, line: str) -> None:
        self._lines.append(line)
        if self._flushing is None and not self._is_closed:
            self._flushing = self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._flushing = None
        if self._is_closed or not self._lines:
            return
        stats = self._adapter.context.stats
        if self._transport.get_write_buffer_size() > self._adapter.config.queue_bytes:
            stats.dropped += len(self._lines)
            stats.last_error = "a user of the text bridge read too slowly and was disconnected"
            self.abort()
            return
        data = ("\n".join(self._lines) + "\n").encode("utf-8", "replace")
        self._lines.clear()
        stats.bytes_sent += len(data)
        self._transport.write(data)
        if self._is_half_open and self._session is not None and not self._session.is_owed:
            self._end()

    def _end(self) -> None:
        self._flush()
        self._is_closed = True
        self._transport.close()
        self._linger = self._loop.call_later(LINGER_S, self._transport.abort)

    def abort(self) -> None:
        """End it at once."""
        self._is_closed = True
        self._transport.abort()


class MoosTextAdapter:
    """Serves lines of text.

    Attributes:
        clock: time of the variables, s since 1970.
        database: the variables.
    """

    Config = MoosTextConfig

    def __init__(self, config: MoosTextConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.clock = MoosClock(1.0, asyncio.get_running_loop().time)
        self.database = Database("text", self.clock.now, config.max_variables)
        self._world: LocalClient | None = None
        self._connections: dict[TextConnection, None] = {}
        self._sessions: dict[str, TextSession] = {}
        self._last_number = 0

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: see there.
            CannotServe: the table names what is not there.
        """
        config, stats = self.config, self.context.stats
        try:
            server = await asyncio.get_running_loop().create_server(
                lambda: TextConnection(self), config.bind, config.port, backlog=256
            )
        except OSError as error:
            raise cannot_listen(error, config.bind, config.port) from error
        line = SerialLine(config.serial, self) if config.serial else None
        detach: Callable[[], None] | None = None
        try:
            self._world = LocalClient(config.bridge, self.context, self.database, self.clock)
            self.database.join(f"{OWN_NAME}_errors", self._tell_error)
            self.database.register(f"{OWN_NAME}_errors", ERROR, 0.0)
            detach = self.context.attach(self._world.bridge)
            host = f"[{config.bind}]" if ":" in config.bind else config.bind
            stats.address = f"{host}:{server.sockets[0].getsockname()[1]}"
            stats.state = "running"
            ready.set()
            while True:
                self.database.tell()
                if line is not None:
                    line.attend()
                await asyncio.sleep(TELL_S)
        finally:
            if detach is not None:
                detach()
            server.close()
            if line is not None:
                line.close()
            for connection in list(self._connections):
                connection.abort()
            if self._world is not None:
                self._world.close()
            await asyncio.sleep(0)  # aborted connections are gone with the next turn of the loop
            stats.state = "stopped"

    def _tell_error(self, letter: Letter) -> None:
        """A refusal of the world goes to who asked for it."""
        said = msgspec.json.decode(letter.message.data)
        session = self._sessions.get(said["src"])
        if session is not None:
            session.refuse(said["code"], f"{said['variable']}: {said['message']}")

    # -- for connections and sessions -----------------------------------------------------------------------------------------------

    def enter(self, connection: TextConnection) -> bool:
        """Whether there is room."""
        room = len(self._connections) < self.config.max_clients
        self._connections[connection] = None
        return room

    def exit(self, connection: TextConnection) -> None:
        """A connection is gone."""
        self._connections.pop(connection, None)

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
        self.database.leave(session.name)
        self.context.stats.peers = len(self._sessions)

    def call(self, text: str, source: str, answer: Callable[[Answer], None]) -> None:
        """Begin a service call for a user."""
        assert self._world is not None
        self._world.bridge.call(text, source, answer)
