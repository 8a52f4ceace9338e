"""Telemetry logs: each frame after eight bytes of UTC, as MAVProxy, QGroundControl and mavlogdump.py read them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

_BUFFER = 1 << 16


class Tlog:
    """Writes one file, anew.

    Args:
        path: of the file; a relative one starts from the folder in which the server was started.
        unix_us: time, microseconds since 1970.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(self, path: str, unix_us: Callable[[], int]) -> None:
        self._now = unix_us
        self._file = Path(path).open("wb", buffering=_BUFFER)  # noqa: SIM115  # closed by `close`

    def write(self, frame: bytes) -> None:
        """One frame, sent or received."""
        self._file.write(self._now().to_bytes(8, "big") + frame)

    def close(self) -> None:
        """End it."""
        self._file.close()
