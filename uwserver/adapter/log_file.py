"""A file to which an adapter logs while it serves. Its contents are on the disk within a second, and writing never delays the traffic."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from pathlib import Path
from typing import BinaryIO

from uwserver.adapter.contract import AdapterContext

log = logging.getLogger(__name__)

FLUSH_S = 1.0
"""Wall time after which written bytes are in the file at the latest, and so what a killed server loses."""
_BUFFER = 1 << 16


class LogFile:
    """Writes one file. An earlier file of this name is kept under the next free number (``dive_1.alog``). Loop thread.

    If writing fails, because the disk is full, for example, the file ends; the error is reported, and the adapter goes on.

    Args:
        path: path of the file; a relative path starts from the folder in which the server was started.
        context: context of the adapter, whose `stats` report errors.

    Raises:
        OSError: the file cannot be opened.
    """

    def __init__(self, path: str, context: AdapterContext) -> None:
        self._path = path
        self._context = context
        self._flushing: asyncio.TimerHandle | None = None
        _keep(Path(path))
        self._file: BinaryIO | None = Path(path).open("wb", buffering=_BUFFER)  # noqa: SIM115  # closed by `close`

    def write(self, data: bytes) -> None:
        """Append bytes, unless the file has ended."""
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
        self._context.stats.count_error(text)
        log.warning("%s: %s", self._context.name, text)
        file, self._file = self._file, None
        if file is not None:
            # To close the file writes its buffer, which cannot be written either.
            with contextlib.suppress(OSError):
                file.close()

    def close(self) -> None:
        """Write what is buffered, and close the file."""
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
