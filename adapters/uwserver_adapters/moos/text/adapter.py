"""The adapter `moos_text`: MOOS variables as lines of text, on TCP, and on a serial line or pseudo-terminal."""

from __future__ import annotations

import asyncio

from uwserver.adapter import (
    HIGH_WATER,
    AdapterBase,
    AdapterContext,
    Connection,
    InputTurns,
    Peers,
    SerialPort,
    address_text,
    serve_tcp,
)
from uwserver.ports import Fault
from uwserver_adapters.moos.bridge.bridge import ERROR
from uwserver_adapters.moos.config import MoosTextConfig
from uwserver_adapters.moos.db.local import OWN_NAME, RIVAL, LocalClient
from uwserver_adapters.moos.text.lines import error_line
from uwserver_adapters.moos.text.session import TextSession, Users

LINE_UNREAD_S = 0.05
"""Wall time before a listing goes on of which too much waits for the line."""
FULL = 1 << 14
"""Bytes that may wait for the line before a listing pauses."""
UNREAD_S = 0.01
"""Wall time before a listing goes on whose user had not read what was sent."""


class SerialLine:
    """The one user of a device that may come and go. QUIT ends the session; the next one begins when the device is opened again.

    Args:
        path: path of the device. Its speed stays as the system has set it (`stty`).
        users: all users.

    Attributes:
        port: the device.
    """

    def __init__(self, path: str, users: Users) -> None:
        self._path = path
        self._users = users
        self._session: TextSession | None = None
        self.port = SerialPort(path, users.context, opened=self._begin, received=self._take, closed=self._end)
        self._turns = InputTurns(self._step, self.port.pause, self.port.resume)

    def _begin(self) -> None:
        self._session = TextSession(self._users, f"serial {self._path}", self._send, self.port.close)

    def _end(self) -> None:
        session, self._session = self._session, None
        self._turns.stop()
        if session is not None:
            session.close()

    def _take(self, data: bytes) -> None:
        if self._session is not None:
            self._session.receive(data)
        self._turns.begin()

    def _step(self) -> bool:
        """Carry out the next stored line, or the next piece of one."""
        session = self._session
        if session is not None and session.is_busy and self.port.waiting > FULL:
            self._turns.rest(LINE_UNREAD_S)
            return False
        return session is not None and session.step()

    def _send(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\r\n"
        if self.port.write(data):
            self._users.context.stats.bytes_sent += len(data)
        else:
            self._users.context.stats.dropped += 1


class TextConnection(Connection):
    """One user on TCP.

    Args:
        users: all users.
        peers: all connections.
        name: name of this user as a client of the database.
    """

    def __init__(self, users: Users, peers: Peers[TextConnection], name: str) -> None:
        super().__init__(peers, users.config.first_line_s)
        self._users = users
        self._name = name
        self._session: TextSession
        self._is_open = False
        self._lines: list[str] = []
        self._flushing: asyncio.Handle | None = None

    def opened(self) -> None:
        """Begin a session."""
        self._session = TextSession(self._users, self._name, self._send, self.close)
        self._is_open = True

    def refused(self, fault: Fault) -> bytes:
        """Return the line for a user that finds no place, or that said nothing."""
        return f"{error_line('', fault.code, fault.text)}\n".encode()

    def closed(self) -> None:
        """End the session."""
        if self._flushing is not None:
            self._flushing.cancel()
        if self._is_open:
            self._session.close()

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._session.receive(data)

    def step(self) -> bool:
        """Carry out the next line, or the next piece of one, unless the user does not read what came of it before."""
        return not self._is_full and self._session.step(self.admit)

    @property
    def _is_full(self) -> bool:
        """Whether so much output of a line waits for the user that the rest of the line has to wait too."""
        return self._session.is_busy and self.waiting > min(HIGH_WATER, self._users.config.queue_bytes // 2)

    def quiet_until(self) -> float:
        """Return when the rest of a line is tried again."""
        return self.loop.time() + UNREAD_S if self._is_full else 0.0

    @property
    def has_pending_output(self) -> bool:
        """Whether lines may still come for a user that sends nothing more (``echo LIST | nc -N``)."""
        return bool(self._lines) or self._session.has_pending_output

    def close(self) -> None:
        """Send all lines, then close."""
        self._flush()
        super().close()

    def _send(self, line: str) -> None:
        self._lines.append(line)
        if self._flushing is None and not self.is_closing:
            self._flushing = self.loop.call_soon(self._flush)

    def _flush(self) -> None:
        """Send all lines of this turn of the loop together."""
        self._flushing = None
        if self.is_closing or not self._lines:
            return
        stats = self._users.context.stats
        if self.waiting > self._users.config.queue_bytes:
            stats.dropped += len(self._lines)
            stats.last_error = "a user of the text bridge read too slowly and was disconnected"
            self.abort()
            return
        data = ("\n".join(self._lines) + "\n").encode("utf-8", "replace")
        self._lines.clear()
        stats.bytes_sent += len(data)
        self.write(data)
        self.finish_if_done()


class MoosTextAdapter(AdapterBase[MoosTextConfig]):
    """Serves lines of text."""

    Config = MoosTextConfig

    def __init__(self, config: MoosTextConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self._users = Users(config, context)
        self._peers: Peers[TextConnection] = Peers(config.max_clients, self.refusals)
        self._last_number = 0

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: the address cannot be had.
            CannotServe: the table names what is not there.
        """
        users, config = self._users, self.config
        line = SerialLine(config.serial, users) if config.serial else None
        async with serve_tcp(self._connection, self._peers, config.bind, config.port, rival=RIVAL) as server:
            world = LocalClient(config.bridge, self.context, users.database, users.clock)
            users.database.join(f"{OWN_NAME}_errors", users.tell_error)
            users.database.register(f"{OWN_NAME}_errors", ERROR, 0.0)
            try:
                await world.serve(
                    address_text(config.bind, server.port), ready, lambda: None if line is None else line.port.attend()
                )
            finally:
                if line is not None:
                    line.port.close()
                users.background.close()

    def _connection(self) -> TextConnection:
        self._last_number += 1
        return TextConnection(self._users, self._peers, f"text{self._last_number}")
