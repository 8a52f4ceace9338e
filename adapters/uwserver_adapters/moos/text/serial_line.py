"""The text bridge on a serial line or pseudo-terminal."""

from __future__ import annotations

import asyncio

from uwserver.adapter import TURN_S, SerialPort
from uwserver_adapters.moos.text.session import TextSession, Users

REST_S = 0.004
"""Wall time before the next turn, once one is used up."""
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
        self._loop = asyncio.get_running_loop()
        self._session: TextSession | None = None
        self._turn: asyncio.TimerHandle | None = None
        self.port = SerialPort(path, users.context, opened=self._begin, received=self._take, closed=self._end)

    def _begin(self) -> None:
        self._session = TextSession(self._users, f"serial {self._path}", self._send, self.port.close)

    def _end(self) -> None:
        session, self._session = self._session, None
        if self._turn is not None:
            self._turn.cancel()
            self._turn = None
        if session is not None:
            session.close()

    def _take(self, data: bytes) -> None:
        if self._session is not None:
            self._session.receive(data)
        if self._turn is None:
            self._work()

    def _work(self) -> None:
        """Carry out stored lines for one turn. While some are left nothing more is read of the line."""
        self._turn = None
        end = self._loop.time() + TURN_S
        while self._session is not None:
            if self._session.is_busy and self.port.waiting > FULL:
                self._rest(UNREAD_S)
                return
            if not self._session.step():
                self.port.resume()
                return
            if self._loop.time() >= end:
                self._rest(REST_S)
                return

    def _rest(self, seconds: float) -> None:
        if self._session is not None:
            self.port.pause()
            self._turn = self._loop.call_later(seconds, self._work)

    def _send(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\r\n"
        if self.port.write(data):
            self._users.context.stats.bytes_sent += len(data)
        else:
            self._users.context.stats.dropped += 1
