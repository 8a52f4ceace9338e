"""The text bridge on a serial line or pseudo-terminal."""

from __future__ import annotations

from uwserver.adapter import SerialPort
from uwserver_adapters.moos.text.lines import LineDecoder
from uwserver_adapters.moos.text.session import Host, TextSession


class SerialLine:
    """One user on a device that may come and go: it is opened again when it can be.

    Args:
        path: of the device; its speed stays as the system has set it (`stty`).
        host: database and world.
    """

    def __init__(self, path: str, host: Host) -> None:
        self._path = path
        self._host = host
        self._session: TextSession | None = None
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
        if session is not None:
            session.close()

    def _take(self, data: bytes) -> None:
        self._decoder.receive(data)
        while self._session is not None and (event := self._decoder.next_event()) is not None:
            self._session.take(event)

    def _send(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\r\n"
        if self._port.write(data):
            self._host.context.stats.bytes_sent += len(data)
        else:
            self._host.context.stats.dropped += 1
