"""A serial line or pseudo-terminal that may come and go."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Callable

from uwserver.adapter.contract import AdapterContext

try:
    import termios
    import tty
except ImportError:  # Windows
    termios = None  # type: ignore[assignment]

log = logging.getLogger(__name__)

_PIECE = 1 << 14
WAITING = 1 << 16
"""Bytes that wait for a slow line; newer ones are dropped above."""


class SerialPort:
    """Opened by `attend`, again and again. Loop thread.

    Args:
        path: of the device; its speed stays as the system has set it (`stty`).
        context: of the adapter; its `stats` and the log tell why the device cannot be opened, or why it closed.
        opened: called when it is open.
        received: takes bytes.
        closed: called when it was open and is not any more.
    """

    def __init__(
        self,
        path: str,
        context: AdapterContext,
        *,
        opened: Callable[[], None],
        received: Callable[[bytes], None],
        closed: Callable[[], None],
    ) -> None:
        self._path = path
        self._context = context
        self._opened, self._received, self._closed = opened, received, closed
        self._told = ""
        self._file = -1
        self._waiting = bytearray()

    @property
    def is_open(self) -> bool:
        """Whether bytes can be written."""
        return self._file >= 0

    @property
    def waiting(self) -> int:
        """Bytes that are not written yet."""
        return len(self._waiting)

    def attend(self) -> None:
        """Open the device if it is not; to be called now and then."""
        if self._file >= 0:
            return
        if termios is None:
            self._fail("this system has no terminals as POSIX has: use UDP or TCP")
            return
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            if os.isatty(self._file):
                tty.setraw(self._file, termios.TCSANOW)
        except (OSError, termios.error) as error:
            self._fail(str(error))
            return
        self._told = ""
        self._opened()
        asyncio.get_running_loop().add_reader(self._file, self._read)

    def _fail(self, reason: str) -> None:
        """Say so, in the log once until it is open again or fails for another reason."""
        self.close()
        text = f"serial line {self._path}: {reason}; it is tried again"
        self._context.stats.last_error = text
        if text != self._told:
            self._told = text
            log.warning("%s: %s", self._context.name, text)

    def _read(self) -> None:
        try:
            data = os.read(self._file, _PIECE)
        except BlockingIOError:
            return
        except OSError as error:  # the other end of a pseudo-terminal went
            self._fail(str(error))
            return
        if data:
            self._received(data)
        else:
            self._fail("closed")

    def pause(self) -> None:
        """Read nothing more until `resume`."""
        if self._file >= 0:
            asyncio.get_running_loop().remove_reader(self._file)

    def resume(self) -> None:
        """Read on."""
        if self._file >= 0:
            asyncio.get_running_loop().add_reader(self._file, self._read)

    def write(self, data: bytes) -> bool:
        """Write when the line takes it; False when too much waits already, or it is not open."""
        if self._file < 0 or len(self._waiting) + len(data) > WAITING:
            return False
        self._waiting += data
        self._write()
        return True

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
        del self._waiting[:written]
        if self._waiting:
            loop.add_writer(self._file, self._write)
        else:
            loop.remove_writer(self._file)

    def close(self) -> None:
        """End it."""
        if self._file < 0:
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._file)
        loop.remove_writer(self._file)
        with contextlib.suppress(OSError):
            os.close(self._file)
        self._file = -1
        self._waiting.clear()
        self._closed()
