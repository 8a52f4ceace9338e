"""Which reader a file wants, told by its first bytes."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path

from uwserver.logfiles.foreign import foreign
from uwserver.logfiles.log import Limits, Log, LogError

_HEAD_BYTES = 4096
ABOUT = "log.json"
"""What `uwserver export --to csv` says of the tables beside it."""
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
        LogError: there is no such file, it is no log of a known format, it is damaged from the start, it asks for more than the limits, or the
            package that reads it is not installed.
    """
    path = Path(path)
    with foreign(path, "it cannot be opened as a log"):
        reader = importlib.import_module(f"uwserver.logfiles.{_READERS[kind_of(path)]}")
        log: Log = reader.open_file(path, limits or Limits())
    return log


def kind_of(path: Path) -> str:
    """The format of a file or folder by its first bytes; of text, which has none, by its name.

    Raises:
        LogError: it is none that is known here.
        OSError: it cannot be read.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "rosbag2"
        if (path / ABOUT).is_file():
            return "csv"
        raise LogError(f"{path}: a folder without metadata.yaml and {ABOUT}, so no ROS 2 bag and no export of uwserver")
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
    if path.suffix.lower() in (".tlog", ".bin"):  # with bytes before the first whole record, as of a damaged card
        return path.suffix.lower()[1:]
    known = "MCAP, .tlog, ArduPilot .bin, .alog, ROS bags, .ulg, .csv and Parquet"
    raise LogError(f"{path}: begins with {head[:8].hex(' ')}, as no log does that is read here: {known}")
