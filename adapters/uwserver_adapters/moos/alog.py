"""The log of MOOS: a line for each write, ``seconds variable source value``, as alogview and aloggrep read it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from uwserver.adapter import AdapterContext

_log = logging.getLogger(__name__)

FLUSH_S = 1.0
"""Wall time after which lines are in the file at the latest, so that a killed server loses no more."""
_RULE = "%" * 80
_BUFFER = 1 << 16


class Alog:
    """Writes one file, anew; an earlier one of this name is kept under the next free number (``dive_1.alog``). Times are seconds since its
    start. When the disk is full, say, it ends and tells so; all else goes on.

    Args:
        path: of the file; a relative one starts from the folder in which the server was started.
        now: MOOS time, s.
        context: whose `stats` tell of errors.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, path: str, now: Callable[[], float], context: AdapterContext) -> None:
        self._start = now()
        self._path = path
        self._context = context
        self._flushing: asyncio.TimerHandle | None = None
        _keep(Path(path))
        self._file: TextIO | None
        self._file = Path(path).open("w", encoding="utf-8", errors="replace", buffering=_BUFFER)  # noqa: SIM115  # closed by `close`
        head = (f"LOG FILE:       {path}", "FILE OPENED BY  uwserver", f"LOGSTART        {self._start:.3f}")
        self._put("\n".join((_RULE, *(f"%% {line}" for line in head), _RULE)) + "\n")

    def write(self, time: float, variable: str, source: str, value: float | str | bytes) -> None:
        """One line. Line ends within names and texts become spaces; binary values are told by their size."""
        if isinstance(value, bytes):
            value = f"<binary> {len(value)} bytes"
        text = value if isinstance(value, str) else f"{value:.10g}"
        words = (f"{time - self._start:<15.3f}", f"{_line(variable):<25}", f"{_line(source) or '-':<16}", _line(text))
        self._put(" ".join(words) + "\n")

    def _put(self, text: str) -> None:
        if self._file is None:
            return
        try:
            self._file.write(text)
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
        _log.warning("%s: %s", self._context.name, text)
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


def _line(text: str) -> str:
    return " ".join(text.splitlines())
