"""A serial line or pseudo-terminal, which may appear and disappear while the adapter runs."""

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
"""Bytes that may wait for a slow line; further ones are dropped."""


class SerialPort:
    """A device that `attend` opens, and opens again after it was lost. Loop thread.

    Args:
        path: path of the device. Its speed stays as the system has set it (`stty`).
        context: context of the adapter. Its `stats` and the log say why the device cannot be opened, or why it closed.
        opened: called when the device has been opened.
        received: called with received bytes.
        closed: called when the device was open and is not any more.
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
        self._logged = ""
        self._file = -1
        self._waiting = bytearray()

    @property
    def is_open(self) -> bool:
        """Whether the device is open."""
        return self._file >= 0

    @property
    def waiting(self) -> int:
        """Bytes that wait to be written."""
        return len(self._waiting)

    def attend(self) -> None:
        """Open the device if it is not open. Call this regularly."""
        if self.is_open:
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
        self._logged = ""
        self._opened()
        self.resume()

    def _fail(self, reason: str) -> None:
        """Close the device and report why. The same reason is logged only once until the device is open again."""
        self.close()
        text = f"serial line {self._path}: {reason}; it is tried again"
        self._context.stats.last_error = text
        if text != self._logged:
            self._logged = text
            log.warning("%s: %s", self._context.name, text)

    def _read(self) -> None:
        try:
            data = os.read(self._file, _PIECE)
        except BlockingIOError:
            return
        except OSError as error:
            # For example because the other end of a pseudo-terminal has closed.
            self._fail(str(error))
            return
        if data:
            self._received(data)
        else:
            self._fail("closed")

    def pause(self) -> None:
        """Stop reading until `resume`."""
        if self.is_open:
            asyncio.get_running_loop().remove_reader(self._file)

    def resume(self) -> None:
        """Go on reading."""
        if self.is_open:
            asyncio.get_running_loop().add_reader(self._file, self._read)

    def write(self, data: bytes) -> bool:
        """Write bytes as the line takes them; return False if too many wait already, or the device is not open."""
        if not self.is_open or len(self._waiting) + len(data) > WAITING:
            return False
        self._waiting += data
        self._write()
        return True

    def _write(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            del self._waiting[: os.write(self._file, self._waiting)]
        except BlockingIOError:
            pass
        except OSError:
            self.close()
            return
        if self._waiting:
            loop.add_writer(self._file, self._write)
        else:
            loop.remove_writer(self._file)

    def close(self) -> None:
        """Close the device."""
        if not self.is_open:
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._file)
        loop.remove_writer(self._file)
        with contextlib.suppress(OSError):
            os.close(self._file)
        self._file = -1
        self._waiting.clear()
        self._closed()
