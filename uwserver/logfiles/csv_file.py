"""Tables as text (.csv, .tsv): a header with the names of the columns, one of them the time; and folders of them, as `uwserver export` writes.

In such a folder ``log.json`` names the topic of each table, and tells the UTC of time 0.
"""

from __future__ import annotations

import csv
import mmap
from array import array
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from uwserver.logfiles.columns import field_of, stamp_of, time_column
from uwserver.logfiles.indexed import Decode, Entries, IndexedLog, Source, mapped
from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.opening import ABOUT
from uwserver.logfiles.timebase import Timebase, time_base
from uwserver.physics.kernel.arrays import IntArray

_MOST_ABOUT_BYTES = 1 << 24
_PIECE_BYTES = 1 << 22
_LONGEST_ROW = 1 << 20
_ROWS_LOOKED_AT = 20


class _Table(NamedTuple):
    """A table that was walked through: its columns, what reads a row, and stamp (ns) and place of each row with a time; rows without one."""

    fields: tuple[LogField, ...]
    decode: Decode
    stamps: array[int]
    places: array[int]
    bad: int


class _Topic(Struct):
    topic: str
    file: str
    schema: str = ""


class _About(Struct):
    """``log.json`` of a folder."""

    topics: list[_Topic]
    epoch_ns: int = -1


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """The log in a table, or in a folder of `uwserver export`.

    Raises:
        LogError: it has no header, no column of time, or not one row with a time; the text names the line.
    """
    if path.is_dir():
        return _open_folder(path, limits)
    data = mapped(path)
    try:
        table = _table(path, data, limits)
    except BaseException:
        data.close()
        raise
    base = time_base(np.frombuffer(table.stamps, np.int64), utc=True)
    entries = Entries(np.zeros(len(table.stamps), np.int32), np.frombuffer(table.places, np.int64))
    source = Source(path.stem, "", table.fields, table.decode)
    return IndexedLog(path, "csv", [source], entries, base, remarks=_remarks(table), close=data.close)


def _open_folder(path: Path, limits: Limits) -> IndexedLog:
    about = _about(path)
    if len(about.topics) > limits.topics:
        raise LogError(f"{path}: {len(about.topics)} tables, more than {limits.topics}")
    with ExitStack() as stack:
        sources, stamps, places, remarks = list[Source](), list[IntArray](), list[IntArray](), list[str]()
        known = set[tuple[int, int]]()
        for topic in about.topics:
            if Path(topic.file).name != topic.file:  # a log names no path
                raise LogError(f"{path / ABOUT}: {topic.file[:80]!r} is no name of a file in this folder")
            if not (path / topic.file).is_file():
                raise LogError(f"{path / topic.file}: there is no such table, though {ABOUT} beside it names it")
            entry = (path / topic.file).stat()
            if (entry.st_dev, entry.st_ino) in known:  # a file of a few bytes could name a large one thousands of times
                raise LogError(f"{path / ABOUT}: two topics are of one table, {topic.file[:80]!r}: each has its own")
            known.add((entry.st_dev, entry.st_ino))
            data = stack.enter_context(closing(mapped(path / topic.file)))
            table = _table(path / topic.file, data, limits)
            sources.append(Source(topic.topic, topic.schema, table.fields, table.decode))
            stamps.append(np.frombuffer(table.stamps, np.int64))
            places.append(np.frombuffer(table.places, np.int64))
            remarks += [f"{topic.file}: {remark}" for remark in _remarks(table)]
        t_ns = np.concatenate([np.zeros(0, np.int64), *stamps])
        numbers = np.repeat(np.arange(len(sources), dtype=np.int32), [len(each) for each in stamps])
        epoch = about.epoch_ns if about.epoch_ns >= 0 else None
        base = Timebase(t_ns, np.argsort(t_ns, kind="stable"), epoch, ())
        entries = Entries(numbers, np.concatenate([np.zeros(0, np.int64), *places]))
        return IndexedLog(path, "csv", sources, entries, base, remarks=remarks, close=stack.pop_all().close)


def _about(path: Path) -> _About:
    with (path / ABOUT).open("rb") as file:
        raw = file.read(_MOST_ABOUT_BYTES)
    try:
        about = msgspec.json.decode(raw, type=_About)
    except msgspec.MsgspecError as error:
        raise LogError(f"{path / ABOUT}: {error}: `uwserver export --to csv` did not write it") from error
    if len({topic.topic for topic in about.topics}) < len(about.topics):
        raise LogError(f"{path / ABOUT}: two tables are of one topic")
    return about


def _remarks(table: _Table) -> list[str]:
    return [f"{table.bad} rows have no time that can be read, and are left out"] if table.bad else []


def _table(path: Path, data: mmap.mmap, limits: Limits) -> _Table:
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

    def decode(place: int) -> Mapping[str, object]:
        stop = data.find(b"\n", place)
        text = data[place : stop if stop >= 0 else len(data)].decode(errors="replace").strip("\r\n")
        return {name: _value(cell) for name, cell in zip(names, _cells(text, separator), strict=False) if cell.strip()}

    return _Table(fields, decode, stamps, places, bad)


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
