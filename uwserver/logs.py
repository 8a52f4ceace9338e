"""Logging of the server: readable lines, or a JSON object on each line.

A text may hold what a stranger has sent. So whatever it holds, a record is one line and sends nothing to a terminal: see `on_one_line`.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import sys
import traceback
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    _Stream = logging.StreamHandler[TextIO]
else:
    _Stream = logging.StreamHandler  # the class takes no type argument in Python 3.10

TOLD_S = 60.0
"""Time for which a cause that was written is only counted."""
VARIED = 10
"""Lines with arguments that are written for one cause in that time, as their arguments may differ."""
CAUSES = 256
"""Causes that are remembered. If there are more, the oldest is forgotten."""
_CAUSE_LENGTH = 200

_CONTROLS = (*range(0x20), *range(0x7F, 0xA0))
_SEPARATORS_AND_DIRECTIONS = (0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A))
_AS_TEXT = {
    **{code: f"\\x{code:02x}" for code in _CONTROLS},
    **{code: f"\\u{code:04x}" for code in _SEPARATORS_AND_DIRECTIONS},
    **str.maketrans({"\t": "\\t", "\n": "\\n", "\r": "\\r"}),
}
# JSON itself escapes the controls below 0x20.
_AS_JSON = {code: f"\\u{code:04x}" for code in (*_CONTROLS[0x20:], *_SEPARATORS_AND_DIRECTIONS)}


def on_one_line(text: str) -> str:
    """Return a text with an escape sequence, such as ``\\x1b``, for each character that could begin a new line, hide or reorder others, or command
    a terminal: controls (C0, DEL, C1), separators of lines, and marks of direction."""
    return text.translate(_AS_TEXT)


class LineFormatter(logging.Formatter):
    """Writes a record as one line. The lines of a traceback follow it, indented, so that none of them looks like a record."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        record.message = on_one_line(record.message)
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:
        """Return the lines of a traceback."""
        return "\n".join(f"  {on_one_line(line)}" for line in super().formatException(ei).split("\n"))


class JsonFormatter(logging.Formatter):
    """Writes ``{"time": ..., "level": ..., "logger": ..., "text": ...}``, with the time in Unix seconds."""

    def format(self, record: logging.LogRecord) -> str:
        """Return one line."""
        entry: dict[str, object] = {
            "time": record.created,
            "level": record.levelname.lower(),
            "logger": record.name,
            "text": record.getMessage(),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False).translate(_AS_JSON)


@dataclass
class _Cause:
    """A cause since its first line.

    Attributes:
        begin: Unix time of the first line, s.
        written, held: how many lines were written, and held back.
        last: the last line that was held back.
    """

    begin: float
    written: int = 0
    held: int = 0
    last: logging.LogRecord | None = None


class SparingLog(_Stream):
    """Writes each cause once a minute, and afterwards how often it came in that minute.

    So a flood of lines neither fills the disk nor hides other lines. A library may write a line for each write to a peer that is gone, or
    a traceback for each connection that cannot be accepted.

    A cause is the logger, the level, the first line of the text before its arguments are inserted, and the type of the exception. Lines
    with arguments may differ, so `VARIED` of them are written.
    """

    def __init__(self, stream: TextIO) -> None:
        super().__init__(stream)
        self._causes: dict[tuple[str, int, str, str], _Cause] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Write the record, or count it."""
        self._summarise_due(record.created)
        if record.levelno < logging.INFO or self._is_to_be_written(record):
            super().emit(record)

    def flush(self) -> None:
        """Write the counts of causes whose minute is over."""
        with self.lock or contextlib.nullcontext():
            if self._causes:
                # A new record has the present time, by the clock of other records.
                self._summarise_due(logging.makeLogRecord({}).created)
            super().flush()

    def close(self) -> None:
        """Write all counts."""
        with self.lock or contextlib.nullcontext():
            self._summarise_due(float("inf"))
        super().close()

    def _is_to_be_written(self, record: logging.LogRecord) -> bool:
        exception = record.exc_info[0] if record.exc_info else None
        text = str(record.msg).partition("\n")[0][:_CAUSE_LENGTH]
        key = (record.name, record.levelno, text, exception.__name__ if exception else "")
        cause = self._causes.get(key)
        if cause is None:
            if len(self._causes) >= CAUSES:
                oldest = next(iter(self._causes))
                self._summarise(self._causes.pop(oldest))
            cause = self._causes[key] = _Cause(record.created)
        if cause.written < (VARIED if record.args else 1):
            cause.written += 1
            return True
        cause.held += 1
        cause.last = record
        return False

    def _summarise_due(self, now: float) -> None:
        # Causes are in the order in which they began.
        while self._causes:
            key, cause = next(iter(self._causes.items()))
            if now - cause.begin < TOLD_S:
                return
            del self._causes[key]
            self._summarise(cause)

    def _summarise(self, cause: _Cause) -> None:
        last = cause.last
        if last is not None:
            text = "%s (%d more of these since the line before)"
            args = (last.getMessage().partition("\n")[0], cause.held)
            super().emit(logging.LogRecord(last.name, last.levelno, last.pathname, last.lineno, text, args, None))


class TerminalFormatter(LineFormatter):
    """Writes lines for a person: time of day, level if it is not that of information, and text.

    Lines have a colour, unless NO_COLOR is set, to tell them from other output.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return one line, with the traceback below it."""
        begin, end = _DIM if record.levelno < logging.WARNING else _YELLOW, "\x1b[0m"
        if os.environ.get("NO_COLOR"):
            begin = end = ""
        level = f"{record.levelname.lower()}: " if record.levelno != logging.INFO else ""
        line = f"{begin}{self.formatTime(record, '%H:%M:%S')} {level}{on_one_line(record.getMessage())}{end}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


_DIM, _YELLOW = "\x1b[2m", "\x1b[33m"


def set_up_logging(level: str, as_json: bool) -> None:
    """Log to standard error the lines of this level and above, each cause once a minute."""
    output = SparingLog(sys.stderr)
    if as_json:
        output.setFormatter(JsonFormatter())
    elif sys.stderr.isatty():
        output.setFormatter(TerminalFormatter())
    else:
        output.setFormatter(LineFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=level.upper(), handlers=[output], force=True)
    # At level debug numba writes lines for every byte-code.
    logging.getLogger("numba").setLevel(logging.WARNING)


def place_of(error: BaseException, file: str = "") -> tuple[str, int]:
    """Return the file and line at which an error was raised; with `file`, the last line of that file in the traceback, 0 if there is none."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if file in ("", frame.filename)]
    return (frames[-1].filename, frames[-1].lineno or 0) if frames else (file, 0)
