"""A recording in parts as one log."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from msgspec import structs

from uwserver.logfiles.foreign import foreign
from uwserver.logfiles.log import Datum, Kind, Log, LogError, Topic
from uwserver.logfiles.mcap_file import head_of
from uwserver.logfiles.opening import open_log
from uwserver.logfiles.part_files import FIRST_PART, PART, RUN, later_parts, part_of, part_path
from uwserver.logfiles.timebase import LATE_NS


def open_parts(path: Path) -> Log:
    """Open a log of any origin; of a recording in parts all of them, by the name of the first.

    Raises:
        LogError: as of `open_log`; or a part is missing.
    """
    first = open_log(path)
    if first.kind != "uwserver":
        return first
    logs = [first]
    try:
        logs += [open_log(part) for part in _later(path)]
    except BaseException:
        for log in logs:
            log.close()
        raise
    return first if len(logs) == 1 else JoinedLog(logs)


def _later(path: Path) -> list[Path]:
    """The other parts of a run by the name of its first; none of what is no first part."""
    with foreign(path, "its parts cannot be read"):
        first = head_of(path)
        if PART not in first or part_of(first) != FIRST_PART:
            return []
        there = [number for number, other in later_parts(path).items() if head_of(other).get(RUN) == first.get(RUN)]
    for expected, number in enumerate(there, FIRST_PART + 1):
        if number != expected:
            missing = part_path(path, expected).name
            raise LogError(f"{path}: its part {missing} is missing, {part_path(path, number).name} is there")
    return [part_path(path, number) for number in there]


class JoinedLog:
    """A `Log` of several, one behind the other. Where one begins before the last has ended, as after a reset, its times go on from there."""

    kind: Kind = "uwserver"

    def __init__(self, logs: list[Log]) -> None:
        """logs: at least one, in their order."""
        self._logs = logs
        self.path, self.epoch_ns, self.start_ns = logs[0].path, logs[0].epoch_ns, logs[0].start_ns
        self._shifts: list[int] = []
        remarks: list[str] = []
        end = self.start_ns
        for log in logs:
            is_back = log.start_ns < end - LATE_NS
            self._shifts.append(end - log.start_ns if is_back else 0)
            name = log.path.name
            remarks += [f"{name}: {remark}" for remark in log.remarks]
            if is_back:
                remarks.append(f"{name}: the time was set back: its times go on from the end of the part before")
            end = max(end, log.end_ns + self._shifts[-1])
        self.end_ns = end
        self.remarks = tuple(remarks)
        topics: dict[str, Topic] = {}
        for log in logs:
            for name, topic in log.topics.items():
                before = topics.get(name)
                counts = (0 if before is None else before.count, topic.count)
                count = None if counts[0] is None or counts[1] is None else counts[0] + counts[1]
                topics[name] = structs.replace(topic, count=count, first_ns=None, last_ns=None)
        self.topics: Mapping[str, Topic] = topics

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """As in `Log`."""
        newest = self.start_ns
        for log, shift in zip(self._logs, self._shifts, strict=True):
            first, last = (None if limit is None else limit - shift for limit in (start_ns, end_ns))
            for t_ns, topic, value in log.read(topics, first, last):
                newest = max(newest, t_ns + shift)  # a sample that was late stands behind the seam
                yield Datum(newest, topic, value)

    def close(self) -> None:
        """As in `Log`."""
        for log in self._logs:
            log.close()
