"""Dataflash logs of ArduPilot (.bin): records that describe themselves.

A FMT record says how records of a type are laid out; UNIT, MULT and FMTU say their units. The letters of layouts are pymavlink's; records are
found and unpacked here, as its reader prints what it does not like, and keeps every record as an object.
"""

from __future__ import annotations

import mmap
import re
import struct
from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uwserver.logfiles.indexed import Decode, Entries, IndexedLog, Source, mapped
from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.timebase import Timebase, time_base
from uwserver.units import NANOSECONDS

_FMT = 0x80
_FMT_BYTES = 89
_FMT_BODY = struct.Struct("<BB4s16s64s")
_BEGIN = re.compile(rb"\xa3\x95")
_PADDING = re.compile(rb"[\x00\xff]*")
_GPS_EPOCH_NS = 315_964_800 * NANOSECONDS
"""1980-01-06."""
_LEAP_NS = 18 * NANOSECONDS
"""GPS time is ahead of UTC by so much since 2017."""
_WEEK_MS = 604_800_000
_PREFIXES = {1e-1: "d", 1e-2: "c", 1e-3: "m", 1e-6: "u", 1e-9: "n", 1.0: ""}


class Layout(NamedTuple):
    """How the records of one type are laid out.

    Attributes:
        name: of the type.
        length: of a record, with its three first bytes.
        names: of the columns.
        body: what unpacks the bytes after the first three.
        letters: of the columns' types.
        factors: that turn a stored number into one of its unit; None where it is stored so.
        units: of the columns; "" where nobody says.
        instance: index of the column that numbers the instances; -1 where there is none.
    """

    name: str
    length: int
    names: tuple[str, ...]
    body: struct.Struct
    letters: str
    factors: tuple[float | None, ...]
    units: tuple[str, ...] = ()
    instance: int = -1


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """The log in a .bin file.

    Raises:
        LogError: no record is described in it.
    """
    data = mapped(path)
    scan = _Scan(data)
    if not scan.layouts:
        lost = len(data)
        data.close()
        raise LogError(f"{path}: no FMT record in {lost} bytes: no dataflash log")
    layouts = _with_units(scan, data)
    stamps, places, types = _stamped(scan, data)
    remarks = [f"{scan.lost} of {len(data)} bytes are no record, and left out"] if scan.lost else []
    if scan.unusable:
        remarks.append(f"types with layouts that cannot be read are left out: {', '.join(sorted(scan.unusable)[:8])}")
    if not len(stamps):
        data.close()
        raise LogError(f"{path}: descriptions of records, but not one with a time")
    base = time_base(stamps, utc=False)
    sources, numbers = _sources(data, layouts, types, places)
    if len(sources) > limits.topics:
        raise LogError(f"{path}: {len(sources)} kinds of records, more than {limits.topics}")
    base = base._replace(epoch_ns=_epoch(data, layouts, base, types, places))
    return IndexedLog(path, "bin", sources, Entries(numbers, places), base, remarks=remarks, close=data.close)


class _Scan:
    """Types and places of all records; their layouts."""

    def __init__(self, data: mmap.mmap) -> None:
        self.layouts: dict[int, Layout] = {}
        self.types, self.places = array("B"), array("q")
        self.lost = 0
        self.unusable: set[str] = set()
        lengths = [0] * 256
        lengths[_FMT] = _FMT_BYTES
        at, end = 0, len(data)
        find, add_type, add_place = _BEGIN.search, self.types.append, self.places.append
        while at + 3 <= end:
            first, second, type_ = data[at : at + 3]
            length = lengths[type_]
            if first == 0xA3 and second == 0x95 and length and at + length <= end:
                if type_ == _FMT:
                    self._describe(data[at + 3 : at + length], lengths)
                elif type_ in self.layouts:
                    add_type(type_)
                    add_place(at)
                at += length
                continue
            found = find(data, at + 1)
            after = found.start() if found else end
            # Pages of flash end in zeros or ones.
            padding = _PADDING.fullmatch(data, at, after)
            self.lost += 0 if padding else after - at
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
    """The layout that a FMT record describes; None when it contradicts itself or has letters that nobody knows."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    names = tuple(columns.split(",")) if columns else ()
    if not name.isidentifier() or not names or len(names) != len(letters) or len(set(names)) != len(names):
        return None
    if any(letter not in FORMAT_TO_STRUCT for letter in letters):
        return None
    described: list[Any] = [FORMAT_TO_STRUCT[letter] for letter in letters]
    body = struct.Struct("<" + "".join(code for code, _, _ in described))
    if body.size + 3 != length:
        return None
    return Layout(name, length, names, body, letters, tuple(factor for _, factor, _ in described))


def _text(raw: bytes) -> str:
    return raw.partition(b"\0")[0].decode("ascii", errors="replace")


def _with_units(scan: _Scan, data: mmap.mmap) -> dict[int, Layout]:
    """The layouts with what UNIT, MULT and FMTU say of them."""
    types = {layout.name: type_ for type_, layout in scan.layouts.items()}
    all_types, all_places = np.frombuffer(scan.types, np.uint8), np.frombuffer(scan.places, np.int64)

    def rows(name: str) -> list[dict[str, Any]]:
        if name not in types:
            return []
        decode = _decoder(scan.layouts[types[name]], data)
        return [dict(decode(at) or {}) for at in all_places[all_types == types[name]].tolist()]

    units = {
        chr(row["Id"]): row["Label"] for row in rows("UNIT") if isinstance(row.get("Id"), int) and 0 <= row["Id"] < 128
    }
    factors = {
        chr(row["Id"]): float(f"{row['Mult']:.7g}")
        for row in rows("MULT")
        if isinstance(row.get("Id"), int) and 0 <= row["Id"] < 128 and isinstance(row.get("Mult"), float)
    }
    layouts = dict(scan.layouts)
    for row in rows("FMTU"):
        layout = layouts.get(row.get("FmtType", -1))
        letters, more = row.get("UnitIds"), row.get("MultIds")
        if layout is None or not isinstance(letters, str) or not isinstance(more, str):
            continue
        named = [
            _scaled(str(units.get(letter, "")), factors.get(more[k : k + 1], 1.0), layout.factors[k])
            for k, letter in enumerate(letters[: len(layout.names)])
        ]
        named += [""] * (len(layout.names) - len(named))
        layouts[row["FmtType"]] = layout._replace(units=tuple(named), instance=letters[: len(layout.names)].find("#"))
    return layouts


def _scaled(unit: str, factor: float, own: float | None) -> str:
    """A unit as the values have it: columns whose letter holds a factor are given in the unit itself."""
    if not unit or unit in ("instance", "UNKNOWN") or own is not None or factor in (0.0, 1.0):
        return "" if unit in ("instance", "UNKNOWN") else unit
    return _PREFIXES[factor] + unit if factor in _PREFIXES else f"{factor:.4g} {unit}"


def _stamped(scan: _Scan, data: mmap.mmap) -> tuple[Any, Any, Any]:
    """Stamps (ns since boot), places and types of all records that have a time, or come after one that has."""
    stamps = array("q")
    kept = array("q")
    clocks: dict[int, tuple[struct.Struct, int]] = {}
    for type_, layout in scan.layouts.items():
        if layout.names[0] == "TimeUS" and layout.letters[0] == "Q":
            clocks[type_] = (struct.Struct("<Q"), 1000)
        elif layout.names[0] == "TimeMS" and layout.letters[0] == "I":
            clocks[type_] = (struct.Struct("<I"), 1_000_000)
    newest = -1
    for k, (type_, at) in enumerate(zip(scan.types, scan.places, strict=True)):
        clock = clocks.get(type_)
        if clock is not None:
            newest = min(clock[0].unpack_from(data, at + 3)[0] * clock[1], 1 << 62)
        if newest >= 0:
            stamps.append(newest)
            kept.append(k)
    chosen = np.frombuffer(kept, np.int64)
    types, places = np.frombuffer(scan.types, np.uint8), np.frombuffer(scan.places, np.int64)
    return np.frombuffer(stamps, np.int64), places[chosen], types[chosen]


def _sources(data: mmap.mmap, layouts: Mapping[int, Layout], types: Any, places: Any) -> tuple[list[Source], Any]:
    """The topics (``IMU[0]`` where a type has instances), and the number of that of each record."""
    sources: list[Source] = []
    numbers = np.zeros(len(types), np.int32)
    for type_ in np.unique(types).tolist():
        layout = layouts[type_]
        rows = np.flatnonzero(types == type_)
        decode = _decoder(layout, data)
        units = layout.units or ("",) * len(layout.names)
        fields = tuple(LogField(n, t, u) for n, t, u in zip(layout.names, layout.letters, units, strict=True))
        if layout.instance < 0 or layout.letters[layout.instance] not in "bB":
            numbers[rows] = len(sources)
            sources.append(Source(layout.name, layout.name, fields, decode))
            continue
        skip = 3 + struct.calcsize("<" + "".join(_codes(layout.letters[: layout.instance])))
        which = np.array([data[at + skip] for at in places[rows].tolist()], np.int32)
        for instance in np.unique(which).tolist():
            numbers[rows[which == instance]] = len(sources)
            sources.append(Source(f"{layout.name}[{instance}]", layout.name, fields, decode))
    return sources, numbers


def _codes(letters: str) -> list[str]:
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    return [str(FORMAT_TO_STRUCT[letter][0]) for letter in letters]


def _decoder(layout: Layout, data: mmap.mmap) -> Decode:
    unpack, names, size = layout.body.unpack_from, layout.names, layout.length
    special = [
        (k, name, None if factor is None else 1 / factor, letter)
        for k, (name, factor, letter) in enumerate(zip(names, layout.factors, layout.letters, strict=True))
        if factor is not None or letter in "anNZ"
    ]

    def decode(at: int) -> Mapping[str, object]:
        values = unpack(data[at + 3 : at + size])
        found: dict[str, object] = dict(zip(names, values, strict=True))
        for k, name, divisor, letter in special:
            if divisor is not None:
                found[name] = values[k] / divisor
            elif letter == "a":
                found[name] = list(struct.unpack("<32h", values[k]))
            else:
                found[name] = values[k].partition(b"\0")[0].decode(errors="backslashreplace")
        return found

    return decode


def _epoch(data: mmap.mmap, layouts: Mapping[int, Layout], base: Timebase, types: Any, places: Any) -> int | None:
    """UTC of time 0 by the first fix of a GPS; None without one."""
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
