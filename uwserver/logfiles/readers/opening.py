"""Opens a log with the reader for its format, which the first bytes of the file show, and a recording in several parts as one log."""

from __future__ import annotations

import pkgutil
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from msgspec import structs

from uwserver.logfiles.log import Datum, Kind, Limits, Log, LogError, Topic, foreign
from uwserver.logfiles.part_files import MissingPart, parts_of_run
from uwserver.logfiles.timebase import LATE_NS

_HEAD_BYTES = 4096
ABOUT = "log.json"
"""File in which `uwserver export --to csv` describes the tables beside it."""
_READERS: Mapping[str, str] = {
    "mcap": "mcap_file:open_file",
    "tlog": "tlog:open_file",
    "bin": "dataflash:open_file",
    "alog": "alog:open_file",
    "bag": "bags:open_file",
    "rosbag2": "bags:open_file",
    "ulg": "ulog:open_file",
    "csv": "tables:open_text",
    "parquet": "tables:open_parquet",
}
"""Module and function of the reader of each format. They are imported when they are used, as some need packages that may be missing."""
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
        open_file = pkgutil.resolve_name(f"uwserver.logfiles.readers.{_READERS[kind_of(path)]}")
        log: Log = open_file(path, limits or Limits())
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


def open_parts(path: Path) -> Log:
    """Open a log of any format. The first part of a recording in parts opens all of them.

    Raises:
        LogError: as `open_log`, or a part is missing.
    """
    first = open_log(path)
    if first.kind != "uwserver":
        return first
    from uwserver.logfiles.readers.mcap_file import head_of

    logs = [first]
    try:
        with foreign(path, "its parts cannot be read"):
            try:
                paths = parts_of_run(path, head_of)
            except MissingPart as error:
                raise LogError(str(error)) from error
        logs += [open_log(part) for part in paths[1:]]
    except BaseException:
        for log in logs:
            log.close()
        raise
    return first if len(logs) == 1 else JoinedLog(logs)


class JoinedLog:
    """A `Log` of several logs, one after the other. A log that begins before the end of the last, as after a reset, is shifted to that end."""

    kind: Kind = "uwserver"

    def __init__(self, logs: list[Log]) -> None:
        """Join at least one log, in the given order."""
        self._logs = logs
        self.path, self.epoch_ns, self.start_ns = logs[0].path, logs[0].epoch_ns, logs[0].start_ns
        self._shifts: list[int] = []
        self.topics: dict[str, Topic] = {}
        remarks: list[str] = []
        self.end_ns = self.start_ns
        for log in logs:
            is_back = log.start_ns < self.end_ns - LATE_NS
            self._shifts.append(self.end_ns - log.start_ns if is_back else 0)
            name = log.path.name
            remarks += [f"{name}: {remark}" for remark in log.remarks]
            if is_back:
                remarks.append(f"{name}: the time was set back: its times continue from the end of the part before")
            self.end_ns = max(self.end_ns, log.end_ns + self._shifts[-1])
            for topic in log.topics.values():
                self._add_topic(topic)
        self.remarks = tuple(remarks)

    def _add_topic(self, topic: Topic) -> None:
        before = self.topics.get(topic.name)
        count = topic.count
        if before is not None:
            count = None if before.count is None or count is None else before.count + count
        self.topics[topic.name] = structs.replace(topic, count=count, first_ns=None, last_ns=None)

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """Yield data, as `Log.read`."""
        newest = self.start_ns
        for log, shift in zip(self._logs, self._shifts, strict=True):
            first, last = (None if limit is None else limit - shift for limit in (start_ns, end_ns))
            for t_ns, topic, value in log.read(topics, first, last):
                newest = max(newest, t_ns + shift)  # a late sample may be in the part after its time
                yield Datum(newest, topic, value)

    def close(self) -> None:
        """Close all files, as `Log.close`."""
        for log in self._logs:
            log.close()
