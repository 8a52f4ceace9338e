"""The log of MOOS: a line for each write, ``seconds variable source value``, as alogview and aloggrep read it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

_RULE = "%" * 80
_BUFFER = 1 << 16


class Alog:
    """Writes one file, anew. Times are seconds since its start.

    Args:
        path: of the file; a relative one starts from the folder in which the server was started.
        now: MOOS time, s.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(self, path: str, now: Callable[[], float]) -> None:
        self._start = now()
        self._file = Path(path).open("w", encoding="utf-8", errors="replace", buffering=_BUFFER)  # noqa: SIM115  # closed by `close`
        head = (f"LOG FILE:       {path}", "FILE OPENED BY  uwserver", f"LOGSTART        {self._start:.3f}")
        self._file.write("\n".join((_RULE, *(f"%% {line}" for line in head), _RULE)) + "\n")

    def write(self, time: float, variable: str, source: str, value: float | str | bytes) -> None:
        """One line. Line ends within names and texts become spaces; binary values are told by their size."""
        if isinstance(value, bytes):
            value = f"<binary> {len(value)} bytes"
        text = value if isinstance(value, str) else f"{value:.10g}"
        words = (f"{time - self._start:<15.3f}", f"{_line(variable):<25}", f"{_line(source) or '-':<16}", _line(text))
        self._file.write(" ".join(words) + "\n")

    def close(self) -> None:
        """End it."""
        self._file.close()


def _line(text: str) -> str:
    return " ".join(text.splitlines())
