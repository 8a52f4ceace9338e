"""Telemetry logs: each frame after eight bytes of UTC, as MAVProxy, QGroundControl and mavlogdump.py read them."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.adapter import AdapterContext, LogFile


class Tlog:
    """Writes one `LogFile`.

    Args:
        path: of the file.
        unix_us: time, microseconds since 1970.
        context: whose `stats` tell of errors.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, path: str, unix_us: Callable[[], int], context: AdapterContext) -> None:
        self._now = unix_us
        self._file = LogFile(path, context)

    def write(self, frame: bytes) -> None:
        """One frame, sent or received."""
        self._file.write(self._now().to_bytes(8, "big") + frame)

    def close(self) -> None:
        """End it."""
        self._file.close()
