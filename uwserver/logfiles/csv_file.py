"""Reads tables in text files (.csv, .tsv), and folders of such tables that `uwserver export` writes.

The header of a table names its columns; one of them is the time. In a folder, ``log.json`` gives the topic of each table and the UTC of time 0.
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

from uwserver.logfiles.columns import field_of, number_or_text, remarks_about, stamp_of, time_column
from uwserver.logfiles.indexed import Entries, IndexedLog, Source, line_blocks, mapped
from uwserver.logfiles.log import Limits, LogError
from uwserver.logfiles.opening import ABOUT
from uwserver.logfiles.timebase import Timebase, Times, time_base

_MOST_ABOUT_BYTES = 1 << 24
_BLOCK_BYTES = 1 << 22
_LONGEST_ROW = 1 << 20


class _Table(NamedTuple):
    """A table that was scanned: its topic, and stamp (ns) and place of each row with a time; the number of rows without one."""

    source: Source
    stamps: Times
    places: Times
    skipped: int


class _Topic(Struct):
    topic: str
    file: str
    schema: str = ""


class _About(Struct):
    """``log.json`` of a folder."""

    topics: list[_Topic]
    epoch_ns: int = -1


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """Open the log in a table, or in a folder of `uwserver export`.

    Raises:
        LogError: it has no header, no time column, or no row with a time; the text names the line.
    """
    with ExitStack() as stack:
        if path.is_dir():
            about = _about(path, limits)
            tables = [_open_table(path / topic.file, topic, limits, stack) for topic in about.topics]
            remarks = [
                f"{t.file}: {text}"
                for t, table in zip(about.topics, tables, strict=True)
                for text in remarks_about(table.skipped)
            ]
            t_ns = np.concatenate([np.zeros(0, np.int64), *(table.stamps for table in tables)])
            epoch = about.epoch_ns if about.epoch_ns >= 0 else None
            # The export wrote times on the time base of its log, whose time 0 must stay.
            base = Timebase(t_ns, np.argsort(t_ns, kind="stable"), epoch, ())
        else:
            tables = [_open_table(path, _Topic(path.stem, path.name), limits, stack)]
            remarks = remarks_about(tables[0].skipped)
            base = time_base(tables[0].stamps, utc=True)
        numbers = np.repeat(np.arange(len(tables), dtype=np.int32), [len(table.stamps) for table in tables])
        entries = Entries(numbers, np.concatenate([np.zeros(0, np.int64), *(table.places for table in tables)]))
        sources = [table.source for table in tables]
        return IndexedLog(path, "csv", sources, entries, base, remarks=remarks, close=stack.pop_all().close)


def _about(path: Path, limits: Limits) -> _About:
    """Read and check the description of a folder."""
    with (path / ABOUT).open("rb") as file:
        raw = file.read(_MOST_ABOUT_BYTES)
    try:
        about = msgspec.json.decode(raw, type=_About)
    except msgspec.MsgspecError as error:
        raise LogError(f"{path / ABOUT}: {error}: `uwserver export --to csv` did not write it") from error
    if len(about.topics) > limits.topics:
        raise LogError(f"{path}: {len(about.topics)} tables, more than {limits.topics}")
    if len({topic.topic for topic in about.topics}) < len(about.topics):
        raise LogError(f"{path / ABOUT}: two tables have the same topic")
    known = set[tuple[int, int]]()
    for topic in about.topics:
        if Path(topic.file).name != topic.file:  # a log must not name files outside its folder
            raise LogError(f"{path / ABOUT}: {topic.file[:80]!r} is not the name of a file in this folder")
        if not (path / topic.file).is_file():
            raise LogError(f"{path / topic.file}: the table is missing, but {ABOUT} names it")
        entry = (path / topic.file).stat()
        if (entry.st_dev, entry.st_ino) in known:  # a small file could name a large one thousands of times
            raise LogError(f"{path / ABOUT}: two topics name the table {topic.file[:80]!r}: each needs its own")
        known.add((entry.st_dev, entry.st_ino))
    return about


def _open_table(path: Path, topic: _Topic, limits: Limits, stack: ExitStack) -> _Table:
    """Scan a table, which stays open until the stack is closed."""
    data = stack.enter_context(closing(mapped(path)))
    at = 3 if data[:3] == b"\xef\xbb\xbf" else 0
    line = 1
    while data[at : at + 1] == b"#":  # comments before the header
        at = data.find(b"\n", at) + 1 or len(data)
        line += 1
    end = data.find(b"\n", at) + 1 or len(data)
    if end - at > _LONGEST_ROW:
        raise LogError(f"{path}:{line}: the header has {end - at} bytes: this is not a table")
    header = data[at:end].decode(errors="replace").strip()
    separator = max(",;\t", key=header.count)
    cells = [name.strip() for name in _cells(header, separator)]
    if len(cells) > limits.topics or not any(cells):
        raise LogError(f"{path}:{line}: the header has {len(cells)} columns: this is not a table")
    names = _unique(cells)
    fields = tuple(field_of(name, "number or text") for name in names)
    time = time_column(f"{path}:{line}", fields)
    stamps, places, skipped = _rows(data, end, separator, time.column, time.factor)
    if not stamps:
        raise LogError(f'{path}:{line + 1}: no row has a time in column "{names[time.column]}"')

    def decode(place: int) -> Mapping[str, object]:
        stop = data.find(b"\n", place)
        text = data[place : stop if stop >= 0 else len(data)].decode(errors="replace").strip("\r\n")
        row = zip(names, _cells(text, separator), strict=False)
        return {name: number_or_text(cell) for name, cell in row if cell.strip()}

    source = Source(topic.topic, topic.schema, fields, decode)
    return _Table(source, np.frombuffer(stamps, np.int64), np.frombuffer(places, np.int64), skipped)


def _rows(data: mmap.mmap, start: int, separator: str, column: int, factor: int) -> tuple[array[int], array[int], int]:
    """Return stamp and place of each row with a time, and the number of rows without one."""
    stamps, places = array("q"), array("q")
    skipped = 0
    comment = separator.encode() * 2 + b"#"
    for at, rows in line_blocks(data, start, _BLOCK_BYTES):
        for row in rows:
            if row.strip():
                stamp = None
                if len(row) <= _LONGEST_ROW and not row.lstrip().startswith(comment):
                    text = row.decode(errors="replace")
                    # The csv module is needed only for quotes; splitting up to the time column is much faster.
                    cells = _cells(text, separator) if b'"' in row else text.split(separator, column + 1)
                    stamp = stamp_of(cells[column], factor) if len(cells) > column else None
                if stamp is None:
                    skipped += 1
                else:
                    stamps.append(stamp)
                    places.append(at)
            at += len(row) + 1
    return stamps, places, skipped


def _cells(text: str, separator: str) -> Sequence[str]:
    return next(csv.reader([text], delimiter=separator), [])


def _unique(names: Sequence[str]) -> list[str]:
    found: dict[str, None] = {}
    for k, name in enumerate(names):
        name = name or f"column_{k + 1}"
        found[name if name not in found else f"{name}_{k + 1}"] = None
    return list(found)
