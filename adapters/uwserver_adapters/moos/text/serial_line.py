"""The text bridge on a serial line or pseudo-terminal."""

from __future__ import annotations

from uwserver.adapter import InputTurns, SerialPort
from uwserver_adapters.moos.text.session import TextSession, Users

UNREAD_S = 0.05
"""Wall time before a listing goes on of which too much waits for the line."""
FULL = 1 << 14
"""Bytes that may wait for the line before a listing pauses."""


class SerialLine:
    """The one user of a device that may come and go. QUIT ends the session; the next one begins when the device is opened again.

    Args:
        path: of the device. Its speed stays as the system has set it (`stty`).
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
            self._turns.rest(UNREAD_S)
            return False
        return session is not None and session.step()

    def _send(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\r\n"
        if self.port.write(data):
            self._users.context.stats.bytes_sent += len(data)
        else:
            self._users.context.stats.dropped += 1
