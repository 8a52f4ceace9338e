"""The log of MOOS: a line for each write, ``seconds variable source value``, as alogview and aloggrep read it."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.adapter import AdapterContext, LogFile

_RULE = "%" * 80


class Alog(LogFile):
    """A log file. Times are seconds since its start.

    Args:
        path: path of the file.
        now: MOOS time, s.
        context: whose `stats` tell of errors.

    Raises:
        OSError: the file cannot be opened.
    """

    def __init__(self, path: str, now: Callable[[], float], context: AdapterContext) -> None:
        super().__init__(path, context)
        self._start = now()
        head = (f"LOG FILE:       {path}", "FILE OPENED BY  uwserver", f"LOGSTART        {self._start:.3f}")
        self._put("\n".join((_RULE, *(f"%% {line}" for line in head), _RULE)))

    def add(self, time: float, variable: str, source: str, value: float | str | bytes) -> None:
        """Write one line. Line ends within names and texts become spaces; of a binary value only the size is written."""
        if isinstance(value, bytes):
            value = f"<binary> {len(value)} bytes"
        text = value if isinstance(value, str) else f"{value:.10g}"
        words = (f"{time - self._start:<15.3f}", f"{_line(variable):<25}", f"{_line(source) or '-':<16}", _line(text))
        self._put(" ".join(words))

    def _put(self, line: str) -> None:
        self.write(f"{line}\n".encode("utf-8", "replace"))


def _line(text: str) -> str:
    return " ".join(text.splitlines())
