"""Logging of the server: readable lines, or one JSON object a line."""

from __future__ import annotations

import json
import logging
import sys
import traceback


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


def set_up_logging(level: str, as_json: bool) -> None:
    """Log to standard error from `level` on."""
    output = logging.StreamHandler(sys.stderr)
    output.setFormatter(
        JsonFormatter() if as_json else logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s")
    )
    logging.basicConfig(level=level.upper(), handlers=[output], force=True)
    # numba talks at debug level about every byte-code.
    logging.getLogger("numba").setLevel(logging.WARNING)


def place_of(error: BaseException, file: str = "") -> tuple[str, int]:
    """File and line where an error was raised; with a `file`, the last line of that file on the way there (0 if none)."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if file in ("", frame.filename)]
    return (frames[-1].filename, frames[-1].lineno or 0) if frames else (file, 0)
