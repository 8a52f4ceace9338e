"""Tables as text (.csv, .tsv): a header with the names of the columns, one of them the time."""

from __future__ import annotations

import csv
import mmap
from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from uwserver.logfiles.columns import field_of, stamp_of, time_column
from uwserver.logfiles.indexed import Entries, IndexedLog, Source, mapped
from uwserver.logfiles.log import Limits, LogError
from uwserver.logfiles.timebase import time_base

_PIECE_BYTES = 1 << 22
_LONGEST_ROW = 1 << 20
_ROWS_LOOKED_AT = 20


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """The log in a table.

    Raises:
        LogError: it has no header, no column of time, or not one row with a time; the text names the line.
    """
    data = mapped(path)
    try:
        return _open(path, data, limits)
    except BaseException:
        data.close()
        raise


def _open(path: Path, data: mmap.mmap, limits: Limits) -> IndexedLog:
    at = 3 if data[:3] == b"\xef\xbb\xbf" else 0
    line = 1
    while data[at : at + 1] == b"#":  # comments before the header
        at = data.find(b"\n", at) + 1 or len(data)
        line += 1
    end = data.find(b"\n", at) + 1 or len(data)
    if end - at > _LONGEST_ROW:
        raise LogError(f"{path}:{line}: a header of {end - at} bytes: no table")
    header = data[at:end].decode(errors="replace").strip()
    separator = max(",;\t", key=header.count)
    cells = [name.strip() for name in _cells(header, separator)]
    if len(cells) > limits.topics or not any(cells):
        raise LogError(f"{path}:{line}: {len(cells)} columns: no table")
    names = _unique(cells)
    fields = tuple(field_of(name, "number or text") for name in names)
    time = time_column(fields)
    if time is None:
        raise LogError(
            f"{path}:{line}: no column of time; name one t_s, time, timestamp ...; there are: {', '.join(names[:20])}"
        )
    stamps, places, bad = _rows(data, end, separator, time.column, time.factor)
    if not stamps:
        raise LogError(f'{path}:{line + 1}: not one row with a time in column "{names[time.column]}"')
    remarks = [f"{bad} rows have no time that can be read, and are left out"] if bad else []

    def decode(place: int) -> Mapping[str, object]:
        stop = data.find(b"\n", place)
        text = data[place : stop if stop >= 0 else len(data)].decode(errors="replace").strip("\r\n")
        return {name: _value(cell) for name, cell in zip(names, _cells(text, separator), strict=False) if cell.strip()}

    base = time_base(np.frombuffer(stamps, np.int64), utc=True)
    entries = Entries(np.zeros(len(stamps), np.int32), np.frombuffer(places, np.int64))
    source = Source(path.stem, "", fields, decode)
    return IndexedLog(path, "csv", [source], entries, base, remarks=remarks, close=data.close)


def _rows(data: mmap.mmap, at: int, separator: str, column: int, factor: int) -> tuple[array[int], array[int], int]:
    """Stamp and place of each row with a time; how many have none."""
    stamps, places = array("q"), array("q")
    bad = 0
    mark = separator.encode()
    while at < len(data):
        end = data.rfind(b"\n", at, at + _PIECE_BYTES) + 1
        if end <= at:
            end = data.find(b"\n", at) + 1 or len(data)
        for row in data[at:end].split(b"\n"):
            if row.strip():
                stamp = None
                if len(row) <= _LONGEST_ROW:
                    text = row.decode(errors="replace")
                    cells = _cells(text, separator) if b'"' in row else text.split(separator, column + 1)
                    stamp = stamp_of(cells[column], factor) if len(cells) > column else None
                if stamp is None or row.lstrip().startswith(mark * 2 + b"#"):
                    bad += 1
                else:
                    stamps.append(stamp)
                    places.append(at)
            at += len(row) + 1
        at = end
    return stamps, places, bad


def _cells(text: str, separator: str) -> Sequence[str]:
    return next(csv.reader([text], delimiter=separator), [])


def _value(cell: str) -> object:
    try:
        return float(cell)
    except ValueError:
        return cell.strip()


def _unique(names: Sequence[str]) -> list[str]:
    found: dict[str, None] = {}
    for k, name in enumerate(names):
        name = name or f"column_{k + 1}"
        found[name if name not in found else f"{name}_{k + 1}"] = None
    return list(found)
