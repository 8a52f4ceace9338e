"""Which reader a file wants, told by its first bytes."""

from __future__ import annotations

import importlib
from pathlib import Path

from uwserver.logfiles.log import Limits, Log, LogError

_HEAD_BYTES = 64
_READERS = {
    "mcap": "mcap_file",
}


def open_log(path: str | Path, limits: Limits | None = None) -> Log:
    """Open a log file, or the folder of a ROS 2 bag.

    Raises:
        LogError: there is no such file, it is no log of a known format, it is damaged from the start, it asks for more than the limits, or the
            package that reads it is not installed.
    """
    path = Path(path)
    kind = _kind(path)
    reader = importlib.import_module(f"uwserver.logfiles.{_READERS[kind]}")
    log: Log = reader.open_file(path, limits or Limits())
    return log


def _kind(path: Path) -> str:
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    if head.startswith(b"\x89MCAP0\r\n"):
        return "mcap"
    raise LogError(f"{path}: no log that is known here")
