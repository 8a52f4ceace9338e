"""Reads MOOS logs (.alog). Each line is a posting: seconds since the start, variable, source, value."""

from __future__ import annotations

import mmap
import re
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np

from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.readers.indexed import Entries, IndexedLog, LogTopic, line_blocks, mapped
from uwserver.logfiles.readers.tables import number_or_text
from uwserver.logfiles.timebase import time_base
from uwserver.units import NANOSECONDS

_START = re.compile(rb"^%%\s*LOGSTART\s+([0-9.eE+-]+)", re.MULTILINE)
_HEAD_BYTES = 65_536
_BLOCK_BYTES = 1 << 24
_LATEST_S = 4_102_444_800.0
"""2100-01-01, in s since 1970."""
_LONGEST_S = 1e9
_UNITS = {"X": "m", "Y": "m", "Z": "m", "DEPTH": "m", "ALTITUDE": "m", "HEADING": "deg", "SPEED": "m/s", "LAT": "deg", "LONG": "deg",
          "PITCH": "rad", "ROLL": "rad", "YAW": "rad"}  # fmt: skip
"""Units of the variables on which all MOOS applications agree, by name without the prefix ``NAV_``."""


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """Open the log in an .alog file.

    Raises:
        LogError: no line of the file is a posting.
    """
    data = mapped(path)
    names, stamps, numbers, places, skipped = _scan(path, data, limits)
    if not stamps:
        data.close()
        raise LogError(f"{path}: no line is a posting (seconds, variable, source, value): not an .alog file")
    remarks = [f"{skipped} lines are no postings and were skipped"] if skipped else []
    epoch = None
    if start := _START.search(data[:_HEAD_BYTES]):
        try:
            began = float(start[1])
        except ValueError:
            began = 0.0
        # Under a time warp MOOS multiplies the time since 1970; the product is far beyond any calendar.
        if 0 < began < _LATEST_S:
            epoch = int(began) * NANOSECONDS + round(began % 1.0 * NANOSECONDS)
        else:
            given = start[1].decode("ascii")[:40]
            remarks.append(f"LOGSTART {given} is not a time since 1970 (a time warp?): the UTC is unknown")
    sources = [_source(name, data) for name in names]
    times = np.round(np.frombuffer(stamps, np.float64) * NANOSECONDS).astype(np.int64)
    base = time_base(times, utc=False)
    if epoch is not None:
        base = base._replace(epoch_ns=epoch + int(times[0]) - int(base.t_ns[0]))
    entries = Entries(np.frombuffer(numbers, np.int32), np.frombuffer(places, np.int64))
    return IndexedLog(path, "alog", sources, entries, base, remarks=remarks, close=data.close)


def _scan(path: Path, data: mmap.mmap, limits: Limits) -> tuple[list[str], array[float], array[int], array[int], int]:
    """Return the names of the variables; seconds, variable number and place of each posting; and the number of other lines."""
    number_of: dict[bytes, int] = {}
    stamps, numbers, places = array("d"), array("i"), array("q")
    skipped = 0
    for at, lines in line_blocks(data, 0, _BLOCK_BYTES):
        if len(lines[0]) > limits.record_bytes:
            raise LogError(f"{path}: the line at byte {at} has {len(lines[0])} bytes: not an .alog file")
        for line in lines:
            words = line.split(None, 2)
            try:
                stamp, name, _ = float(words[0]), words[1], words[2]
            except (ValueError, IndexError):
                skipped += bool(line.strip()) and not line.startswith(b"%")
            else:
                if -_LONGEST_S < stamp < _LONGEST_S:
                    stamps.append(stamp)
                    numbers.append(number_of.setdefault(name, len(number_of)))
                    places.append(at)
                else:
                    skipped += 1
            at += len(line) + 1
        if len(number_of) > limits.topics:
            raise LogError(f"{path}: more than {limits.topics} variables")
    return [name.decode(errors="backslashreplace") for name in number_of], stamps, numbers, places, skipped


def _source(name: str, data: mmap.mmap) -> LogTopic:
    unit = _UNITS.get(name.removeprefix("NAV_"), "")
    fields = (LogField("value", "double or string", unit), LogField("source", "string"))
    return LogTopic(name, "", fields, _report(data) if name.startswith("NODE_REPORT") else _posting(data))


def _posting(data: mmap.mmap) -> Callable[[int], dict[str, object]]:
    find, length = data.find, len(data)
    sources: dict[bytes, str] = {}

    def decode(at: int) -> dict[str, object]:
        end = find(b"\n", at)
        words = data[at : end if end >= 0 else length].split(None, 3)
        text = words[3] if len(words) > 3 else b""
        source = sources.get(words[2])
        if source is None:
            source = sources[words[2]] = words[2].decode(errors="backslashreplace")
        return {"value": number_or_text(text.decode(errors="backslashreplace")), "source": source}

    return decode


def _report(data: mmap.mmap) -> Callable[[int], dict[str, object]]:
    """Return the decoder for postings like ``NAME=alpha,X=1.5,...``, which also gives their parts."""
    posting = _posting(data)

    def decode(at: int) -> dict[str, object]:
        found = posting(at)
        for part in str(found["value"]).split(","):
            key, equals, text = part.partition("=")
            if equals:
                found[key.strip()] = number_or_text(text)
        return found

    return decode
