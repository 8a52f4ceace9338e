"""Logging of the server: readable lines, or one JSON object a line."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import sys
import traceback
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    _Stream = logging.StreamHandler[TextIO]
else:
    _Stream = logging.StreamHandler  # Python 3.10 cannot say of what

TOLD_S = 60.0
"""Time for which a cause that was told is only counted."""
VARIED = 10
"""Lines of one cause in that time that may differ in what they name."""
CAUSES = 256
"""Causes that are remembered; the one that was told least recently is forgotten."""
_CAUSE_LENGTH = 200


class JsonFormatter(logging.Formatter):
    """``{"time": ..., "level": ..., "logger": ..., "text": ...}``; time in Unix seconds."""

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
        entry: dict[str, object] = {
            "time": record.created,
            "level": record.levelname.lower(),
            "logger": record.name,
            "text": record.getMessage(),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False)


class _Cause:
    """What was told of one cause."""

    def __init__(self, begin: float) -> None:
        self.begin = begin
        self.told = 0
        self.held = 0
        self.last: logging.LogRecord | None = None


class SparingLog(_Stream):
    """Writes each cause once a minute, and then how often it came: what floods (a library's line for each write to a peer that is gone, a
    traceback for each connection that cannot be accepted) neither fills a disk nor hides other lines.

    A cause is logger, level, text before its arguments (the first line of it) and type of exception. Lines with arguments may differ, so
    `VARIED` of them are written.
    """

    def __init__(self, stream: TextIO) -> None:
        super().__init__(stream)
        self._causes: dict[tuple[str, int, str, str], _Cause] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Write the record, or count it."""
        self._tell_due(record.created)
        if record.levelno < logging.INFO or self._is_to_be_written(record):
            super().emit(record)

    def flush(self) -> None:
        """Write the counts of causes whose minute is over."""
        with self.lock or contextlib.nullcontext():
            if self._causes:
                self._tell_due(logging.makeLogRecord({}).created)
            super().flush()

    def close(self) -> None:
        """Write all counts."""
        with self.lock or contextlib.nullcontext():
            self._tell_due(float("inf"))
        super().close()

    def _is_to_be_written(self, record: logging.LogRecord) -> bool:
        exception = record.exc_info[0] if record.exc_info else None
        text = str(record.msg).partition("\n")[0][:_CAUSE_LENGTH]
        key = (record.name, record.levelno, text, exception.__name__ if exception else "")
        cause = self._causes.get(key)
        if cause is None:
            if len(self._causes) >= CAUSES:
                oldest = next(iter(self._causes))
                self._tell(self._causes.pop(oldest))
            cause = self._causes[key] = _Cause(record.created)
        if cause.told < (VARIED if record.args else 1):
            cause.told += 1
            return True
        cause.held += 1
        cause.last = record
        return False

    def _tell_due(self, now: float) -> None:
        """Causes stand in the order in which they began."""
        while self._causes:
            key, cause = next(iter(self._causes.items()))
            if now - cause.begin < TOLD_S:
                return
            del self._causes[key]
            self._tell(cause)

    def _tell(self, cause: _Cause) -> None:
        last = cause.last
        if last is not None:
            text = "%s (%d more of these since the line before)"
            args = (last.getMessage().partition("\n")[0], cause.held)
            super().emit(logging.LogRecord(last.name, last.levelno, last.pathname, last.lineno, text, args, None))


class TerminalFormatter(logging.Formatter):
    """A line for whoever sits there: time of day, level where it matters, text; coloured unless NO_COLOR is set, so that it is no part of what else
    is printed."""

    def format(self, record: logging.LogRecord) -> str:
        """One line, and the traceback below it."""
        begin, end = (
            ("", "") if os.environ.get("NO_COLOR") else (_COLOURS[record.levelno >= logging.WARNING], "\x1b[0m")
        )
        level = f"{record.levelname.lower()}: " if record.levelno != logging.INFO else ""
        line = f"{begin}{self.formatTime(record, '%H:%M:%S')} {level}{record.getMessage()}{end}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


_COLOURS = ("\x1b[2m", "\x1b[33m")
"""Dim, and yellow for a warning or worse."""


def set_up_logging(level: str, as_json: bool) -> None:
    """Log to standard error from `level` on, each cause once a minute."""
    output = SparingLog(sys.stderr)
    if as_json:
        output.setFormatter(JsonFormatter())
    elif sys.stderr.isatty():
        output.setFormatter(TerminalFormatter())
    else:
        output.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=level.upper(), handlers=[output], force=True)
    # numba talks at debug level about every byte-code.
    logging.getLogger("numba").setLevel(logging.WARNING)


def place_of(error: BaseException, file: str = "") -> tuple[str, int]:
    """File and line where an error was raised; with a `file`, the last line of that file on the way there (0 if none)."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if file in ("", frame.filename)]
    return (frames[-1].filename, frames[-1].lineno or 0) if frames else (file, 0)
