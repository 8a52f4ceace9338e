"""A recording in several parts as one log."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from msgspec import structs

from uwserver.logfiles.foreign import foreign
from uwserver.logfiles.log import Datum, Kind, Log, LogError, Topic
from uwserver.logfiles.mcap_file import head_of
from uwserver.logfiles.opening import open_log
from uwserver.logfiles.part_files import MissingPart, parts_of_run
from uwserver.logfiles.timebase import LATE_NS


def open_parts(path: Path) -> Log:
    """Open a log of any format. The first part of a recording in parts opens all of them.

    Raises:
        LogError: as `open_log`, or a part is missing.
    """
    first = open_log(path)
    if first.kind != "uwserver":
        return first
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
