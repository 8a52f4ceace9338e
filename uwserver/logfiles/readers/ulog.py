"""Reads PX4 logs (.ulg) with pyulog, which keeps the whole file in memory."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.readers.indexed import Decode, Entries, IndexedLog, LogTopic
from uwserver.logfiles.timebase import FIRST_UTC_NS, LAST_NS, log_times, seconds

_MEMBER = re.compile(r"(.+)\[(\d{1,4})\]")
_MOST_COLUMNS = 131_072
"""Largest number of columns of all topics; a PX4 log has some ten thousand."""


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """Open the log in a .ulg file. Topics have PX4's names; ``sensor_baro[1]`` is a second instance.

    Raises:
        LogError: it contains no data, or is too large to be kept in memory.
    """
    size = path.stat().st_size
    if size > 8 * limits.record_bytes:
        raise LogError(
            f"{path}: the file has {size} bytes, more than the {8 * limits.record_bytes} that are kept in memory"
        )
    # pyulog prints warnings; given a path, it would leave a file open that it does not understand.
    with path.open("rb") as file, redirect_stdout(StringIO()):
        log: Any = _parser()(file)
    if len(log.data_list) > limits.topics:
        raise LogError(f"{path}: {len(log.data_list)} topics, more than {limits.topics}")
    remarks = ["the file is damaged: its readable parts are used"] if log.file_corruption else []
    if log.dropouts:
        lost = seconds(sum(int(dropout.duration) for dropout in log.dropouts) * 1_000_000)
        remarks.append(f"{len(log.dropouts)} dropouts of {lost} in all: the logger could not keep up")
    sources: list[LogTopic] = []
    stamps, numbers, places = [], [], []
    backwards = 0
    for topic in log.data_list:
        times = np.minimum(topic.data["timestamp"], np.uint64(LAST_NS // 1000)).astype(np.int64) * 1000
        backwards += int((np.diff(times) < 0).sum())
        stamps.append(times)
        numbers.append(np.full(len(times), len(sources), np.int32))
        places.append(np.arange(len(times), dtype=np.int64))
        name = topic.name + (f"[{topic.multi_id}]" if topic.multi_id else "")
        if any(source.name == name for source in sources):
            name = f"{name}({len(sources)})"
        sources.append(LogTopic(name, topic.name, _fields(topic), _decoder(topic.data)))
    if not sum(map(len, stamps)):
        raise LogError(f"{path}: the log contains no data")
    if backwards:
        remarks.append(f"the clock goes back {backwards} times; data are read in the order of their stamps")
    base = log_times(np.concatenate(stamps))
    base = base._replace(epoch_ns=_epoch(log, int(np.concatenate(stamps).min())))
    entries = Entries(np.concatenate(numbers), np.concatenate(places))
    return IndexedLog(path, "ulg", sources, entries, base, remarks=remarks)


class _TooMany(Exception):
    """A log with too many columns. It is not a `LogError`, because pyulog takes a ValueError for damage and continues."""


def _parser() -> Any:
    """Return the class ULog, changed to count the columns of a topic before it makes them: nested arrays multiply their number."""
    from pyulog import ULog

    left = _MOST_COLUMNS

    class Subscribed(ULog._MessageAddLogged):  # type: ignore[misc] # noqa: SLF001
        def _parse_format(self, message_formats: Mapping[str, Any]) -> None:
            nonlocal left
            left -= _columns(self.message_name, message_formats, {})
            if left < 0:
                raise _TooMany(f"the topics up to {self.message_name} have more than {_MOST_COLUMNS} columns")
            super()._parse_format(message_formats)

    return type("BoundedULog", (ULog,), {"_MessageAddLogged": Subscribed})


def _columns(name: str, formats: Mapping[str, Any], known: dict[str, int]) -> int:
    """Return the number of values of a type with all that it contains; at least 1, also for an empty type."""
    if name not in formats:
        return 1  # a number; pyulog reports an unknown type
    if name not in known:
        known[name] = _MOST_COLUMNS + 1  # the result for a type that contains itself
        counts = (max(1, size) * _columns(type_, formats, known) for type_, size, _ in formats[name].fields)
        known[name] = max(1, sum(counts))
    return known[name]


def _fields(topic: Any) -> tuple[LogField, ...]:
    found: dict[str, LogField] = {}
    lengths = Counter(name.rpartition("[")[0] for name in topic.data)
    for name, column in topic.data.items():
        is_member = _MEMBER.fullmatch(name)
        if is_member:
            found.setdefault(is_member[1], LogField(is_member[1], f"{column.dtype}[{lengths[is_member[1]]}]"))
        else:
            found[name] = LogField(name, str(column.dtype), "us" if name in ("timestamp", "timestamp_sample") else "")
    return tuple(found.values())


def _decoder(columns: Mapping[str, Any]) -> Decode:
    plan = []
    for name, column in columns.items():
        is_member = _MEMBER.fullmatch(name)
        *outer, last = (is_member[1] if is_member else name).split(".")
        plan.append((outer, last, bool(is_member), column))

    def decode(row: int) -> Mapping[str, object]:
        found: dict[str, Any] = {}
        for outer, last, is_member, column in plan:
            at = found
            for word in outer:
                at = at.setdefault(word, {})
            if is_member:
                at.setdefault(last, []).append(column[row].item())
            else:
                at[last] = column[row].item()
        return found

    return decode


def _epoch(log: Any, first_ns: int) -> int | None:
    """Return the UTC of time 0 from the first GPS fix; None without one."""
    for topic in log.data_list:
        if topic.name in ("vehicle_gps_position", "sensor_gps") and "time_utc_usec" in topic.data:
            fixed = np.flatnonzero(topic.data["time_utc_usec"] > FIRST_UTC_NS // 1000)
            if len(fixed):
                k = fixed[0]
                return int(topic.data["time_utc_usec"][k]) * 1000 - (int(topic.data["timestamp"][k]) * 1000 - first_ns)
    return None
