"""Reads dataflash logs of ArduPilot (.bin), whose records describe themselves.

A FMT record gives the layout of the records of a type; UNIT, MULT and FMTU records give their units. The type letters of layouts come from
pymavlink. Its log reader is not used: it prints warnings, and keeps every record as an object.
"""

from __future__ import annotations

import mmap
import re
import struct
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.readers.indexed import Decode, Entries, IndexedLog, LogTopic, mapped
from uwserver.logfiles.timebase import LAST_NS, Timebase, time_base
from uwserver.units import NANOSECONDS

_FMT = 0x80
_FMT_BYTES = 89
_FMT_BODY = struct.Struct("<BB4s16s64s")
_BEGIN = re.compile(rb"\xa3\x95")
_PADDING = re.compile(rb"[\x00\xff]*")
_GPS_EPOCH_NS = 315_964_800 * NANOSECONDS
"""1980-01-06."""
_LEAP_NS = 18 * NANOSECONDS
"""GPS time has been ahead of UTC by this since 2017."""
_WEEK_MS = 604_800_000
_CLOCKS = {
    ("TimeUS", "Q"): (struct.Struct("<Q").unpack_from, 1000),
    ("TimeMS", "I"): (struct.Struct("<I").unpack_from, 1_000_000),
}
"""Name and letter of a first column that is a time: how it is unpacked, and the ns in its unit."""
_PREFIXES = {1e-1: "d", 1e-2: "c", 1e-3: "m", 1e-6: "u", 1e-9: "n", 1.0: ""}


class Layout(NamedTuple):
    """The layout of the records of one type.

    Attributes:
        name: name of the type.
        length: bytes of a record, with the first three (two marks and the type number).
        names: names of the columns.
        body: unpacks the bytes after the first three.
        letters: type letters of the columns.
        factors: factors from stored numbers to the units; None where numbers are stored in the unit.
        units: units of the columns; "" where the log gives none.
        clock: unpacks the time in the first column, with the ns that its unit has; None when the first column is no time.
        instance: index of the column with the instance number; -1 without one.
    """

    name: str
    length: int
    names: tuple[str, ...]
    body: struct.Struct
    letters: str
    factors: tuple[float | None, ...]
    clock: tuple[Callable[[mmap.mmap, int], tuple[int, ...]], int] | None
    units: tuple[str, ...] = ()
    instance: int = -1


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """Open the log in a .bin file.

    Raises:
        LogError: it describes no record, or contains no record with a time.
    """
    with ExitStack() as stack:
        data = stack.enter_context(closing(mapped(path)))
        scan = _Scan(data)
        if not scan.layouts:
            raise LogError(f"{path}: no FMT record in {len(data)} bytes: not a dataflash log")
        layouts = _with_units(scan, data)
        all_stamps = np.frombuffer(scan.stamps, np.int64)
        stamps = all_stamps[all_stamps >= 0]
        places = np.frombuffer(scan.places, np.int64)[all_stamps >= 0]
        types = np.frombuffer(scan.types, np.uint8)[all_stamps >= 0]
        if not len(stamps):
            raise LogError(f"{path}: the log describes records, but contains none with a time")
        remarks = [f"{scan.lost} of {len(data)} bytes are no record and were skipped"] if scan.lost else []
        if scan.unusable:
            names = ", ".join(sorted(scan.unusable)[:8])
            remarks.append(f"records of these types were skipped, because their layouts cannot be read: {names}")
        base = time_base(stamps, utc=False)
        sources, numbers = _sources(data, layouts, types, places)
        if len(sources) > limits.topics:
            raise LogError(f"{path}: {len(sources)} kinds of records, more than {limits.topics}")
        base = base._replace(epoch_ns=_epoch(data, layouts, base, types, places))
        close = stack.pop_all().close
        return IndexedLog(path, "bin", sources, Entries(numbers, places), base, remarks=remarks, close=close)


class _Scan:
    """The layouts, and the types and places of all records.

    Attributes:
        layouts: by type number.
        types, places: those of each record that has a layout.
        stamps: ns since boot of each of them: its own time, or that of the last record before it with a time; -1 before the first.
        lost: number of bytes that belong to no record.
        unusable: names of types whose layout cannot be read.
    """

    def __init__(self, data: mmap.mmap) -> None:
        self.layouts: dict[int, Layout] = {}
        self.types, self.places, self.stamps = array("B"), array("q"), array("q")
        self.lost = 0
        self.unusable: set[str] = set()
        lengths = [0] * 256
        lengths[_FMT] = _FMT_BYTES
        at, end, newest = 0, len(data), -1
        find, add_type, add_place, add_stamp = _BEGIN.search, self.types.append, self.places.append, self.stamps.append
        while at + 3 <= end:
            first, second, type_ = data[at : at + 3]
            length = lengths[type_]
            if first == 0xA3 and second == 0x95 and length and at + length <= end:
                if type_ == _FMT:
                    self._describe(data[at + 3 : at + length], lengths)
                elif type_ in self.layouts:
                    clock = self.layouts[type_].clock
                    if clock is not None:
                        newest = min(clock[0](data, at + 3)[0] * clock[1], LAST_NS)
                    add_type(type_)
                    add_place(at)
                    add_stamp(newest)
                at += length
                continue
            found = find(data, at + 1)
            after = found.start() if found else end
            if not _PADDING.fullmatch(data, at, after):  # pages of flash are filled up with zeros or ones
                self.lost += after - at
            at = after

    def _describe(self, body: bytes, lengths: list[int]) -> None:
        type_, length, name, letters, columns = _FMT_BODY.unpack(body)
        layout = layout_of(_text(name), length, _text(letters), _text(columns))
        if layout is None:
            self.unusable.add(_text(name) or str(type_))
            lengths[type_] = max(lengths[type_], length if length > 2 else 0)
        elif type_ != _FMT:
            self.layouts[type_] = layout
            lengths[type_] = layout.length


def layout_of(name: str, length: int, letters: str, columns: str) -> Layout | None:
    """Return the layout that a FMT record describes; None when it contradicts itself or contains unknown type letters."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    names = tuple(columns.split(",")) if columns else ()
    if not name.isidentifier() or not names or len(names) != len(letters) or len(set(names)) != len(names):
        return None
    described: list[Any] = [FORMAT_TO_STRUCT[letter] for letter in letters if letter in FORMAT_TO_STRUCT]
    body = struct.Struct("<" + "".join(code for code, _, _ in described))
    if len(described) < len(letters) or body.size + 3 != length:
        return None
    clock = _CLOCKS.get((names[0], letters[0]))
    return Layout(name, length, names, body, letters, tuple(factor for _, factor, _ in described), clock)


def _text(raw: bytes) -> str:
    return raw.partition(b"\0")[0].decode(errors="backslashreplace")


def _with_units(scan: _Scan, data: mmap.mmap) -> dict[int, Layout]:
    """Return the layouts with the units and the instance column that UNIT, MULT and FMTU records give."""
    types, places = np.frombuffer(scan.types, np.uint8), np.frombuffer(scan.places, np.int64)

    def rows(name: str) -> Iterator[Any]:
        for type_, layout in scan.layouts.items():
            if layout.name == name:
                yield from map(_decoder(layout, data), places[types == type_].tolist())

    def by_letter(name: str, column: str) -> dict[str, Any]:
        known = (row for row in rows(name) if isinstance(row.get("Id"), int) and 0 <= row["Id"] < 128)
        return {chr(row["Id"]): row.get(column) for row in known}

    units, factors = by_letter("UNIT", "Label"), by_letter("MULT", "Mult")
    layouts = dict(scan.layouts)
    for row in rows("FMTU"):
        layout = layouts.get(row.get("FmtType", -1))
        letters, factor_letters = row.get("UnitIds"), row.get("MultIds")
        if layout is not None and isinstance(letters, str) and isinstance(factor_letters, str):
            named = tuple(
                _scaled(units.get(letters[k : k + 1]), factors.get(factor_letters[k : k + 1]), own)
                for k, own in enumerate(layout.factors)
            )
            layouts[row["FmtType"]] = layout._replace(units=named, instance=letters[: len(named)].find("#"))
    return layouts


def _scaled(unit: str | None, factor: object, own: float | None) -> str:
    """Return the unit of a column with its prefix. Columns whose type letter has a factor are given in the unit itself."""
    if not unit or unit in ("instance", "UNKNOWN"):
        return ""
    scale = float(f"{factor:.7g}") if isinstance(factor, float) else 1.0
    if own is not None or scale in (0.0, 1.0):
        return unit
    return _PREFIXES[scale] + unit if scale in _PREFIXES else f"{scale:.4g} {unit}"


def _sources(data: mmap.mmap, layouts: Mapping[int, Layout], types: Any, places: Any) -> tuple[list[LogTopic], Any]:
    """Return the topics, ``IMU[0]`` for a type with instances, and the index of the topic of each record."""
    sources: list[LogTopic] = []
    numbers = np.zeros(len(types), np.int32)
    for type_ in np.unique(types).tolist():
        layout = layouts[type_]
        rows = np.flatnonzero(types == type_)
        decode = _decoder(layout, data)
        units = layout.units or ("",) * len(layout.names)
        fields = tuple(LogField(n, t, u) for n, t, u in zip(layout.names, layout.letters, units, strict=True))
        if layout.instance < 0 or layout.letters[layout.instance] not in "bB":
            numbers[rows] = len(sources)
            sources.append(LogTopic(layout.name, layout.name, fields, decode))
            continue
        unpack, k = layout.body.unpack_from, layout.instance
        which = np.array([unpack(data, at + 3)[k] for at in places[rows].tolist()], np.int32)
        for instance in np.unique(which).tolist():
            numbers[rows[which == instance]] = len(sources)
            sources.append(LogTopic(f"{layout.name}[{instance}]", layout.name, fields, decode))
    return sources, numbers


def _decoder(layout: Layout, data: mmap.mmap) -> Decode:
    unpack, names = layout.body.unpack_from, layout.names
    special = [
        (k, name, None if factor is None else 1 / factor, letter)
        for k, (name, factor, letter) in enumerate(zip(names, layout.factors, layout.letters, strict=True))
        if factor is not None or letter in "anNZ"
    ]

    def decode(at: int) -> Mapping[str, object]:
        values = unpack(data, at + 3)
        found: dict[str, object] = dict(zip(names, values, strict=True))
        for k, name, divisor, letter in special:
            if divisor is not None:
                found[name] = values[k] / divisor
            elif letter == "a":
                found[name] = list(struct.unpack("<32h", values[k]))
            else:
                found[name] = _text(values[k])
        return found

    return decode


def _epoch(data: mmap.mmap, layouts: Mapping[int, Layout], base: Timebase, types: Any, places: Any) -> int | None:
    """Return the UTC of time 0 from the first GPS fix; None without one."""
    for type_, layout in layouts.items():
        if layout.name != "GPS" or not {"GMS", "GWk", "Status"} <= set(layout.names):
            continue
        decode = _decoder(layout, data)
        for k in np.flatnonzero(types == type_)[:10_000].tolist():
            row: Any = decode(int(places[k]))
            if row["Status"] >= 3 and 1000 < row["GWk"] < 10_000:
                gps_ns = (row["GWk"] * _WEEK_MS + row["GMS"]) * 1_000_000
                return _GPS_EPOCH_NS + int(gps_ns) - _LEAP_NS - int(base.t_ns[k])
    return None
