"""A file that an adapter logs to while it serves: on the disk within a second, and never in the way of the traffic."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from pathlib import Path
from typing import BinaryIO

from uwserver.adapter.contract import AdapterContext

log = logging.getLogger(__name__)

FLUSH_S = 1.0
"""Wall time after which what was written is in the file at the latest, so that a killed server loses no more."""
_BUFFER = 1 << 16


class LogFile:
    """Writes one file; an earlier one of this name is kept under the next free number (``dive_1.alog``). When the disk is full, say, it ends and
    tells so; all else goes on. Loop thread.

    Args:
        path: of the file; a relative one starts from the folder in which the server was started.
        context: whose `stats` tell of errors.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, path: str, context: AdapterContext) -> None:
        self._path = path
        self._context = context
        self._flushing: asyncio.TimerHandle | None = None
        _keep(Path(path))
        self._file: BinaryIO | None = Path(path).open("wb", buffering=_BUFFER)  # noqa: SIM115  # closed by `close`

    def write(self, data: bytes) -> None:
        """Append; nothing once the file has ended."""
        if self._file is None:
            return
        try:
            self._file.write(data)
        except OSError as error:
            self._fail(error)
        else:
            if self._flushing is None:
                self._flushing = asyncio.get_running_loop().call_later(FLUSH_S, self._flush)

    def _flush(self) -> None:
        self._flushing = None
        if self._file is not None:
            try:
                self._file.flush()
            except OSError as error:
                self._fail(error)

    def _fail(self, error: OSError) -> None:
        text = f"the log {self._path} ends: {error}"
        self._context.stats.errors += 1
        self._context.stats.last_error = text
        log.warning("%s: %s", self._context.name, text)
        file, self._file = self._file, None
        if file is not None:
            with contextlib.suppress(OSError):  # what it still holds cannot be written either
                file.close()

    def close(self) -> None:
        """End it."""
        if self._flushing is not None:
            self._flushing.cancel()
        self._flush()
        if self._file is not None:
            self._file.close()
            self._file = None


def _keep(path: Path) -> None:
    if path.is_file():
        number = 1
        while (kept := path.with_stem(f"{path.stem}_{number}")).exists():
            number += 1
        path.rename(kept)
