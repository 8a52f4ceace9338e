"""The text bridge on a serial line or pseudo-terminal."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import termios
import tty
from typing import TYPE_CHECKING

from uwserver_adapters.moos.text import NEED_DATA, LineDecoder
from uwserver_adapters.moos.text_session import TextSession

if TYPE_CHECKING:
    from uwserver_adapters.moos.text_adapter import MoosTextAdapter

_log = logging.getLogger(__name__)

_PIECE = 1 << 14
WAITING = 1 << 16
"""Bytes that wait for a slow line; newer lines are dropped above."""


class SerialLine:
    """One user on a device that may come and go: it is opened again when it can be.

    Args:
        path: of the device; its speed stays as the system has set it (`stty`).
        adapter: to which it belongs.
    """

    def __init__(self, path: str, adapter: MoosTextAdapter) -> None:
        self._path = path
        self._adapter = adapter
        self._file = -1
        self._session: TextSession | None = None
        self._decoder = LineDecoder(adapter.config.line_bytes)
        self._waiting = bytearray()
        self._told = ""

    async def attend(self) -> None:
        """Open the device if it is not; to be called now and then."""
        if self._file >= 0:
            return
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            if os.isatty(self._file):
                tty.setraw(self._file, termios.TCSANOW)
        except (OSError, termios.error) as error:
            self._fail(f"serial line {self._path}: {error}; it is tried again")
            return
        self._told = ""
        self._decoder = LineDecoder(self._adapter.config.line_bytes)
        self._session = TextSession(self._adapter, f"serial {self._path}", self._send, self._hang_up)
        asyncio.get_running_loop().add_reader(self._file, self._read)

    def _fail(self, text: str) -> None:
        self.close()
        self._adapter.context.stats.last_error = text
        if text != self._told:
            _log.warning("%s: %s", self._adapter.context.name, text)
            self._told = text

    def _hang_up(self) -> None:
        """QUIT ends the session; the line itself stays, for a new one."""
        self.close()

    def _read(self) -> None:
        try:
            data = os.read(self._file, _PIECE)
        except BlockingIOError:
            return
        except OSError as error:  # the other end of a pseudo-terminal went
            self._fail(f"serial line {self._path}: {error}; it is tried again")
            return
        if not data:
            self._fail(f"serial line {self._path}: closed; it is tried again")
            return
        self._decoder.receive(data)
        while self._session is not None and (event := self._decoder.next_event()) is not NEED_DATA:
            self._session.take(event)

    def _send(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\r\n"
        if len(self._waiting) + len(data) > WAITING:
            self._adapter.context.stats.dropped += 1
            return
        self._waiting += data
        self._write()

    def _write(self) -> None:
        if self._file < 0:
            return
        loop = asyncio.get_running_loop()
        try:
            written = os.write(self._file, self._waiting)
        except BlockingIOError:
            written = 0
        except OSError:
            self.close()
            return
        self._adapter.context.stats.bytes_sent += written
        del self._waiting[:written]
        if self._waiting:
            loop.add_writer(self._file, self._write)
        else:
            loop.remove_writer(self._file)

    def close(self) -> None:
        """End session and file."""
        if self._file >= 0:
            loop = asyncio.get_running_loop()
            loop.remove_reader(self._file)
            loop.remove_writer(self._file)
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = -1
        self._waiting.clear()
        session, self._session = self._session, None
        if session is not None:
            session.close()
