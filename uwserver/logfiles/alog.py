"""Logs of MOOS (.alog): a line for each posting: seconds since the start, variable, source, value."""

from __future__ import annotations

import mmap
import re
from array import array
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from uwserver.logfiles.indexed import Decode, Entries, IndexedLog, Source, mapped
from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.timebase import time_base
from uwserver.units import NANOSECONDS

_START = re.compile(rb"^%%\s*LOGSTART\s+([0-9.eE+-]+)", re.MULTILINE)
_HEAD_BYTES = 65_536
_PIECE_BYTES = 1 << 24
_LATEST_S = 4_102_444_800.0
"""2100-01-01."""
_LONGEST_S = 1e9
_UNITS = {"X": "m", "Y": "m", "Z": "m", "DEPTH": "m", "ALTITUDE": "m", "HEADING": "deg", "SPEED": "m/s", "LAT": "deg", "LONG": "deg",
          "PITCH": "rad", "ROLL": "rad", "YAW": "rad"}  # fmt: skip
"""Of the variables that all MOOS applications agree about, without their prefix ``NAV_``."""


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """The log in an .alog file.

    Raises:
        LogError: no line of it is a posting.
    """
    data = mapped(path)
    names, stamps, numbers, places, left_out = _scan(path, data, limits)
    if not stamps:
        data.close()
        raise LogError(f"{path}: no line is a posting (seconds, variable, source, value): no .alog")
    remarks = [f"{left_out} lines are no postings, and left out"] if left_out else []
    epoch = None
    if start := _START.search(data[:_HEAD_BYTES]):
        try:
            began = float(start[1])
        except ValueError:
            began = 0.0
        # Under a time warp MOOS multiplies the time since 1970, and gets far beyond any calendar.
        if 0 < began < _LATEST_S:
            epoch = int(began) * NANOSECONDS + round(began % 1.0 * NANOSECONDS)
        else:
            remarks.append(
                f"LOGSTART {start[1].decode('ascii')[:40]} is no time of ours (a time warp?): UTC is not known"
            )
    sources = [_source(name, data) for name in names]
    times = np.round(np.frombuffer(stamps, np.float64) * NANOSECONDS).astype(np.int64)
    base = time_base(times, utc=False)
    if epoch is not None:
        base = base._replace(epoch_ns=epoch + int(times[0]) - int(base.t_ns[0]))
    entries = Entries(np.frombuffer(numbers, np.int32), np.frombuffer(places, np.int64))
    return IndexedLog(path, "alog", sources, entries, base, remarks=remarks, close=data.close)


def _scan(path: Path, data: mmap.mmap, limits: Limits) -> tuple[list[str], array[float], array[int], array[int], int]:
    """Names of the variables; seconds, number of the variable and place of each line; how many lines are no postings."""
    number_of: dict[bytes, int] = {}
    stamps, numbers, places = array("d"), array("i"), array("q")
    left_out, at = 0, 0
    while at < len(data):
        end = data.rfind(b"\n", at, at + _PIECE_BYTES) + 1
        if end <= at:  # the last line, or one longer than a piece
            end = data.find(b"\n", at) + 1 or len(data)
            if end - at > limits.record_bytes:
                raise LogError(f"{path}: a line of {end - at} bytes at byte {at}: no .alog")
        for line in data[at:end].split(b"\n"):
            words = line.split(None, 2)
            try:
                stamp = float(words[0])
                name = words[1]
                words[2]
            except (ValueError, IndexError):
                left_out += 1 if line.strip() and not line.startswith(b"%") else 0
            else:
                if -_LONGEST_S < stamp < _LONGEST_S:
                    number = number_of.get(name)
                    if number is None:
                        if len(number_of) >= limits.topics:
                            raise LogError(f"{path}: more than {limits.topics} variables")
                        number = number_of.setdefault(name, len(number_of))
                    stamps.append(stamp)
                    numbers.append(number)
                    places.append(at)
                else:
                    left_out += 1
            at += len(line) + 1
        at = end
    return [name.decode(errors="backslashreplace") for name in number_of], stamps, numbers, places, left_out


def _source(name: str, data: mmap.mmap) -> Source:
    unit = _UNITS.get(name.removeprefix("NAV_"), "")
    fields = (LogField("value", "double or string", unit), LogField("source", "string"))
    return Source(name, "", fields, _report(data) if name.startswith("NODE_REPORT") else _posting(data))


def _posting(data: mmap.mmap) -> Callable[[int], dict[str, object]]:
    find, length = data.find, len(data)
    sources: dict[bytes, str] = {}

    def decode(at: int) -> dict[str, object]:
        end = find(b"\n", at)
        words = data[at : end if end >= 0 else length].split(None, 3)
        text = words[3] if len(words) > 3 else b""
        try:
            value: object = float(text)
        except ValueError:
            value = text.rstrip().decode(errors="backslashreplace")
        source = sources.get(words[2])
        if source is None:
            source = sources.setdefault(words[2], words[2].decode(errors="backslashreplace"))
        return {"value": value, "source": source}

    return decode


def _report(data: mmap.mmap) -> Decode:
    """A posting of ``NAME=alpha,X=1.5,...``: also its parts, numbers as numbers."""
    posting = _posting(data)

    def decode(at: int) -> Mapping[str, object]:
        found = posting(at)
        for part in str(found["value"]).split(","):
            key, equals, text = part.partition("=")
            if equals:
                try:
                    found[key.strip()] = float(text)
                except ValueError:
                    found[key.strip()] = text.strip()
        return found

    return decode
