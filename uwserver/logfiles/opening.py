"""Opens a log with the reader for its format, which the first bytes of the file show."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path

from uwserver.logfiles.foreign import foreign
from uwserver.logfiles.log import Limits, Log, LogError

_HEAD_BYTES = 4096
ABOUT = "log.json"
"""File in which `uwserver export --to csv` describes the tables beside it."""
_READERS: Mapping[str, str] = {
    "mcap": "mcap_file",
    "tlog": "tlog",
    "bin": "dataflash",
    "alog": "alog",
    "bag": "bags",
    "rosbag2": "bags",
    "ulg": "ulog",
    "csv": "csv_file",
    "parquet": "parquet_file",
}
_BEGINS = (
    (b"\x89MCAP0\r\n", "mcap"),
    (b"#ROSBAG V2.0\n", "bag"),
    (b"SQLite format 3\0", "rosbag2"),
    (b"ULog\x01\x12\x35", "ulg"),
    (b"PAR1", "parquet"),
    (b"\xa3\x95\x80", "bin"),
    (b"%%%%", "alog"),
)
_TEXT = {".csv": "csv", ".txt": "csv", ".tsv": "csv", ".alog": "alog"}


def open_log(path: str | Path, limits: Limits | None = None) -> Log:
    """Open a log file, or the folder of a ROS 2 bag or of `uwserver export --to csv`.

    Raises:
        LogError: the file does not exist, is not a log of a known format, is damaged at its start, exceeds the limits, or the package that
            reads it is not installed.
    """
    path = Path(path)
    with foreign(path, "it cannot be opened as a log"):
        reader = importlib.import_module(f"uwserver.logfiles.{_READERS[kind_of(path)]}")
        log: Log = reader.open_file(path, limits or Limits())
    return log


def kind_of(path: Path) -> str:
    """Return the format of a file or folder. The first bytes tell it; for text files, which have no such mark, the file name.

    Raises:
        LogError: the format is unknown.
        OSError: the file cannot be read.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "rosbag2"
        if (path / ABOUT).is_file():
            return "csv"
        raise LogError(
            f"{path}: the folder has no metadata.yaml or {ABOUT}: it is not a ROS 2 bag or a uwserver export"
        )
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    for begin, kind in _BEGINS:
        if head.startswith(begin):
            return kind
    if not head:
        raise LogError(f"{path}: the file is empty")
    if len(head) > 16 and head[8] in (0xFE, 0xFD) and head[0] == 0:
        return "tlog"
    if path.suffix.lower() in _TEXT and b"\0" not in head:
        return _TEXT[path.suffix.lower()]
    if path.suffix.lower() in (".tlog", ".bin"):  # a file from a damaged card may begin in the middle of a record
        return path.suffix.lower()[1:]
    known = "MCAP, .tlog, ArduPilot .bin, .alog, ROS bags, .ulg, .csv and Parquet"
    raise LogError(f"{path}: unknown format, the file begins with {head[:8].hex(' ')}; known formats: {known}")
