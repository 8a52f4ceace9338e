"""The text bridge on a serial line or pseudo-terminal."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

from uwserver.adapter import TURN_S, SerialPort
from uwserver_adapters.moos.text.lines import LineDecoder
from uwserver_adapters.moos.text.session import Host, TextSession

REST_S = 0.004
"""Wall time before the next turn, once one is used up."""
UNREAD_S = 0.05
"""Wall time before a listing goes on, of which too much waits for the line."""
FULL = 1 << 14
"""Bytes."""


class SerialLine:
    """One user on a device that may come and go: it is opened again when it can be.

    Args:
        path: of the device; its speed stays as the system has set it (`stty`).
        host: database and world.
    """

    def __init__(self, path: str, host: Host) -> None:
        self._path = path
        self._host = host
        self._loop = asyncio.get_running_loop()
        self._session: TextSession | None = None
        self._steps: Iterator[None] | None = None
        self._turn: asyncio.TimerHandle | None = None
        self._decoder = LineDecoder(host.config.line_bytes)
        self._port = SerialPort(path, host.context, opened=self._begin, received=self._take, closed=self._end)

    def attend(self) -> None:
        """Open the device if it is not; to be called now and then."""
        self._port.attend()

    def close(self) -> None:
        """End session and file. QUIT does so too; the line itself stays, for a new session."""
        self._port.close()

    def _begin(self) -> None:
        self._decoder = LineDecoder(self._host.config.line_bytes)
        self._session = TextSession(self._host, f"serial {self._path}", self._send, self.close)

    def _end(self) -> None:
        session, self._session = self._session, None
        self._steps = None
        if self._turn is not None:
            self._turn.cancel()
            self._turn = None
        if session is not None:
            session.close()

    def _take(self, data: bytes) -> None:
        self._decoder.receive(data)
        if self._turn is None:
            self._work()

    def _work(self) -> None:
        """Take what is there, for one turn; nothing is read before the rest of it had its own."""
        self._turn = None
        end = self._loop.time() + TURN_S
        while self._step():
            if self._loop.time() >= end:
                self._rest(REST_S)
                return
        if self._is_full:
            self._rest(UNREAD_S)
        else:
            self._port.resume()

    def _rest(self, seconds: float) -> None:
        if self._session is not None:
            self._port.pause()
            self._turn = self._loop.call_later(seconds, self._work)

    def _step(self) -> bool:
        """Carry out the next line, or the next piece of one, unless the line has to take what came of it before."""
        if self._session is None or self._is_full:
            return False
        if self._steps is None:
            event = self._decoder.next_event()
            if event is None:
                return False
            self._steps = self._session.take(event)
        if next(self._steps, self) is self:
            self._steps = None
        return True

    @property
    def _is_full(self) -> bool:
        return self._steps is not None and self._port.waiting > FULL

    def _send(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\r\n"
        if self._port.write(data):
            self._host.context.stats.bytes_sent += len(data)
        else:
            self._host.context.stats.dropped += 1
