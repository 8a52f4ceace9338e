"""The text bridge on a serial line or pseudo-terminal."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from uwserver.adapter import SerialPort
from uwserver_adapters.moos.text import NEED_DATA, LineDecoder
from uwserver_adapters.moos.text_session import TextSession

if TYPE_CHECKING:
    from uwserver_adapters.moos.text_adapter import MoosTextAdapter

_log = logging.getLogger(__name__)


class SerialLine:
    """One user on a device that may come and go: it is opened again when it can be.

    Args:
        path: of the device; its speed stays as the system has set it (`stty`).
        adapter: to which it belongs.
    """

    def __init__(self, path: str, adapter: MoosTextAdapter) -> None:
        self._path = path
        self._adapter = adapter
        self._session: TextSession | None = None
        self._decoder = LineDecoder(adapter.config.line_bytes)
        self._told = ""
        self._port = SerialPort(path, opened=self._begin, received=self._take, closed=self._end, failed=self._fail)

    def attend(self) -> None:
        """Open the device if it is not; to be called now and then."""
        self._port.attend()

    def close(self) -> None:
        """End session and file. QUIT does so too; the line itself stays, for a new session."""
        self._port.close()

    def _begin(self) -> None:
        self._told = ""
        self._decoder = LineDecoder(self._adapter.config.line_bytes)
        self._session = TextSession(self._adapter, f"serial {self._path}", self._send, self.close)

    def _end(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.close()

    def _fail(self, text: str) -> None:
        self._adapter.context.stats.last_error = text
        if text != self._told:
            _log.warning("%s: %s", self._adapter.context.name, text)
            self._told = text

    def _take(self, data: bytes) -> None:
        self._decoder.receive(data)
        while self._session is not None and (event := self._decoder.next_event()) is not NEED_DATA:
            self._session.take(event)

    def _send(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\r\n"
        if self._port.write(data):
            self._adapter.context.stats.bytes_sent += len(data)
        else:
            self._adapter.context.stats.dropped += 1
