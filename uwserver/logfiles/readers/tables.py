"""Reads tables in text files (.csv, .tsv) and in Apache Parquet files, and folders of text tables that `uwserver export` writes.

One column of a table is its time; names or metadata of columns give their units. In a folder, ``log.json`` gives the topic of each table and the
UTC of time 0. Parquet files are read with pyarrow, one row group at a time.
"""

from __future__ import annotations

import csv
import mmap
import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.readers.indexed import Entries, IndexedLog, LogTopic, line_blocks, mapped
from uwserver.logfiles.readers.opening import ABOUT
from uwserver.logfiles.si import is_known
from uwserver.logfiles.timebase import LAST_NS, Timebase, Times, time_base, utc_ns

# -- units and times from the names of columns ------------------------------------------------------------------------------------------

_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*)\s*[\])]\s*$")
_SUFFIXES = {
    "mps": "m/s", "mps2": "m/s^2", "radps": "rad/s", "degps": "deg/s", "pa": "Pa", "hpa": "hPa", "kpa": "kPa", "degc": "degC", "v": "V",
    "a": "A", "hz": "Hz", "deg": "deg", "rad": "rad", "m": "m", "cm": "cm", "mm": "mm", "km": "km", "ft": "ft", "s": "s", "ms": "ms",
    "us": "us", "ns": "ns", "kn": "kn", "rpm": "rpm",
}  # fmt: skip
_TIMES = re.compile(r"t|time|timestamp|stamp|t_sent|time_boot|seconds|sec|datetime|date_time|utc", re.IGNORECASE)
_FACTORS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}
_MOST_ABOUT_BYTES = 1 << 24
_BLOCK_BYTES = 1 << 22
_LONGEST_ROW = 1 << 20
_CELL_BYTES = 16
"""Least memory of an unpacked cell."""


class TimeColumn(NamedTuple):
    """Index of the time column, and the ns that one unit of its numbers counts; 0 when their size must show it."""

    column: int
    factor: int


def field_of(name: str, type_: str, unit: str = "", frame: str = "") -> LogField:
    """Return the field of a column. Without a unit, its name may contain one: ``depth_m``, ``depth [m]``."""
    if not unit:
        if bracketed := _BRACKETS.match(name):
            unit = bracketed[2] if is_known(bracketed[2]) else _SUFFIXES.get(bracketed[2].lower(), "")
        elif "_" in name:
            unit = _SUFFIXES.get(name.rpartition("_")[2].lower(), "")
    return LogField(name, type_, unit, frame)


def time_column(where: str, fields: Sequence[LogField]) -> TimeColumn:
    """Return the first column whose name says that it is the time.

    Raises:
        LogError: no column is; the text begins with `where`.
    """
    for k, field in enumerate(fields):
        bracketed = _BRACKETS.match(field.name)
        stem = bracketed[1] if bracketed else field.name
        if field.unit in _FACTORS:
            short = re.sub(rf"_{field.unit}$", "", stem, flags=re.IGNORECASE)
            if _TIMES.fullmatch(short):
                return TimeColumn(k, _FACTORS[field.unit])
        if _TIMES.fullmatch(stem):
            return TimeColumn(k, _FACTORS.get(field.unit, 0))
    names = ", ".join(field.name for field in fields[:20])
    raise LogError(f"{where}: no time column; name one t_s, time, timestamp ...; the columns are: {names}")


def remarks_about(skipped: int) -> list[str]:
    """Return a remark about the rows that were skipped because their time cannot be read; nothing when there are none."""
    return [f"{skipped} rows were skipped: their time cannot be read"] if skipped else []


def number_or_text(cell: str) -> float | str:
    """Return a cell as a number, if it is one, else as text without surrounding spaces."""
    try:
        return float(cell)
    except ValueError:
        return cell.strip()


def stamp_of(text: str, factor: int) -> int | None:
    """Return the ns in a cell, which holds a number or an instant (RFC 3339); None when it holds neither."""
    try:
        number = float(text)
    except ValueError:
        return utc_ns(text)
    if factor == 0:
        # Since 1970, seconds have 10 digits, milliseconds 13, microseconds 16, nanoseconds 19.
        size = abs(number)
        factor = 1_000_000_000 if size < 1e11 else 1_000_000 if size < 1e14 else 1000 if size < 1e17 else 1
    if not abs(number) * factor < LAST_NS:  # also for NaN
        return None
    # Whole numbers stay exact: a float has too few digits for ns since 1970.
    return int(text) * factor if re.fullmatch(r"\s*[+-]?\d+\s*", text) else round(number * factor)


# -- text files -------------------------------------------------------------------------------------------------------------------------


class _Table(NamedTuple):
    """A table that was scanned: its topic, and stamp (ns) and place of each row with a time; the number of rows without one."""

    source: LogTopic
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


def open_text(path: Path, limits: Limits) -> IndexedLog:
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

    source = LogTopic(topic.topic, topic.schema, fields, decode)
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


# -- Parquet ----------------------------------------------------------------------------------------------------------------------------


def open_parquet(path: Path, limits: Limits) -> IndexedLog:
    """Open the log in a Parquet file. Units and frames come from the metadata ``unit`` and ``frame`` of its columns.

    Raises:
        LogError: it has no time column, no row with a time, or a row group exceeds the limits.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(str(path), memory_map=False)
    try:
        _check_size(path, file.metadata, limits)
        schema = file.schema_arrow
        fields = tuple(map(_field, schema))
        time = time_column(str(path), fields)
        stamps, places, skipped = _stamps(file, time, pa.types.is_timestamp(schema.field(time.column).type))
        if not stamps:
            raise LogError(f'{path}: no row has a time in column "{fields[time.column].name}"')
    except BaseException:
        file.close()
        raise
    base = time_base(np.frombuffer(stamps, np.int64), utc=True)
    entries = Entries(np.zeros(len(stamps), np.int32), np.frombuffer(places, np.int64))
    source = LogTopic(path.stem, "", fields, _parquet_decoder(file))
    return IndexedLog(path, "parquet", [source], entries, base, remarks=remarks_about(skipped), close=file.close)


def _check_size(path: Path, about: Any, limits: Limits) -> None:
    if about.num_columns > limits.topics:
        raise LogError(f"{path}: {about.num_columns} columns, more than {limits.topics}")
    for k in range(about.num_row_groups):
        size, rows = about.row_group(k).total_byte_size, about.row_group(k).num_rows
        if not 0 <= size <= limits.record_bytes:
            raise LogError(f"{path}: row group {k} has {size} bytes unpacked, more than {limits.record_bytes}")
        # The size above is that of encoded pages, in which a run of equal values takes no space.
        if rows * about.num_columns * _CELL_BYTES > limits.record_bytes:
            columns = about.num_columns
            raise LogError(f"{path}: row group {k} has {rows} rows of {columns} columns: write smaller row groups")


def _field(column: Any) -> LogField:
    metadata = column.metadata or {}
    unit, frame = (metadata.get(key, b"").decode(errors="replace") for key in (b"unit", b"frame"))
    return field_of(column.name, str(column.type), unit, frame)


def _stamps(file: Any, time: TimeColumn, is_instant: bool) -> tuple[array[int], array[int], int]:
    """Return stamp and place (row group << 32 | row) of each row with a time, and the number of rows without one."""
    import pyarrow as pa

    stamps, places = array("q"), array("q")
    skipped = 0
    name = file.schema_arrow.field(time.column).name
    for group in range(file.metadata.num_row_groups):
        column = file.read_row_group(group, columns=[name]).column(0)
        if is_instant:
            column = column.cast(pa.timestamp("ns")).cast(pa.int64())
        for row, value in enumerate(column.to_pylist()):
            stamp = value if is_instant or value is None else stamp_of(str(value), time.factor)
            if stamp is None:
                skipped += 1
            else:
                stamps.append(stamp)
                places.append(group << 32 | row)
    return stamps, places, skipped


def _parquet_decoder(file: Any) -> Callable[[int], Mapping[str, object]]:
    """Return a function that gives the row at a place, without missing values. The row group that was used last is kept."""

    @lru_cache(maxsize=1)
    def columns(group: int) -> dict[str, list[object]]:
        table = file.read_row_group(group)
        return dict(zip(table.column_names, (column.to_pylist() for column in table.columns), strict=True))

    def decode(place: int) -> Mapping[str, object]:
        row = place & 0xFFFFFFFF
        return {name: column[row] for name, column in columns(place >> 32).items() if column[row] is not None}

    return decode
