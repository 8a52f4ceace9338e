"""Reads tables in Apache Parquet files with pyarrow, one row group at a time."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.logfiles.columns import TimeColumn, field_of, remarks_about, stamp_of, time_column
from uwserver.logfiles.indexed import Entries, IndexedLog, Source
from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.timebase import time_base

_CELL_BYTES = 16
"""Least memory of an unpacked cell."""


def open_file(path: Path, limits: Limits) -> IndexedLog:
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
    source = Source(path.stem, "", fields, _decoder(file))
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


def _decoder(file: Any) -> Callable[[int], Mapping[str, object]]:
    """Return a function that gives the row at a place, without missing values. The row group that was used last is kept."""

    @lru_cache(maxsize=1)
    def columns(group: int) -> dict[str, list[object]]:
        table = file.read_row_group(group)
        return dict(zip(table.column_names, (column.to_pylist() for column in table.columns), strict=True))

    def decode(place: int) -> Mapping[str, object]:
        row = place & 0xFFFFFFFF
        return {name: column[row] for name, column in columns(place >> 32).items() if column[row] is not None}

    return decode
