"""The log of MOOS: a line for each write, ``seconds variable source value``, as alogview and aloggrep read it."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.adapter import AdapterContext, LogFile

_RULE = "%" * 80


class Alog:
    """Writes one `LogFile`. Times are seconds since its start.

    Args:
        path: of the file.
        now: MOOS time, s.
        context: whose `stats` tell of errors.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, path: str, now: Callable[[], float], context: AdapterContext) -> None:
        self._start = now()
        self._file = LogFile(path, context)
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
        self._file.write(text.encode("utf-8", "replace"))

    def close(self) -> None:
        """End it."""
        self._file.close()


def _line(text: str) -> str:
    return " ".join(text.splitlines())
