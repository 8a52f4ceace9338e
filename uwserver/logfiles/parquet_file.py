"""Tables of Apache Parquet, by pyarrow: a row group at a time."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.logfiles.columns import TimeColumn, field_of, stamp_of, time_column
from uwserver.logfiles.indexed import Entries, IndexedLog, Source
from uwserver.logfiles.log import Limits, LogError
from uwserver.logfiles.timebase import time_base

_CELL_BYTES = 16
"""Of memory that a cell takes at least once it is unpacked."""


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """The log in a Parquet file. Units and frames are read from the metadata ``unit`` and ``frame`` of its columns.

    Raises:
        LogError: it has no column of time, not one row with a time, or a row group beyond the limits.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(str(path), memory_map=False)
    try:
        about, schema = file.metadata, file.schema_arrow
        if about.num_columns > limits.topics:
            raise LogError(f"{path}: {about.num_columns} columns, more than {limits.topics}")
        for k in range(about.num_row_groups):
            size = about.row_group(k).total_byte_size
            if not 0 <= size <= limits.record_bytes:
                raise LogError(f"{path}: row group {k} has {size} bytes unpacked, more than {limits.record_bytes}")
            # Pages tell their size as encoded: a run of equal values takes none.
            rows = about.row_group(k).num_rows
            if rows * about.num_columns * _CELL_BYTES > limits.record_bytes:
                raise LogError(
                    f"{path}: row group {k} has {rows} rows of {about.num_columns} columns: write smaller row groups"
                )
        fields = []
        for column in schema:
            said = {
                key.decode(errors="replace"): value.decode(errors="replace")
                for key, value in (column.metadata or {}).items()
            }
            fields.append(field_of(column.name, str(column.type), said.get("unit", ""), said.get("frame", "")))
        time = time_column(fields)
        if time is None:
            names = ", ".join(field.name for field in fields[:20])
            raise LogError(f"{path}: no column of time; name one t_s, time, timestamp ...; there are: {names}")
        is_instant = pa.types.is_timestamp(schema.field(time.column).type)
        stamps, places, bad = _stamps(file, time, is_instant)
        if not stamps:
            raise LogError(f'{path}: not one row with a time in column "{fields[time.column].name}"')
    except BaseException:
        file.close()
        raise
    remarks = [f"{bad} rows have no time that can be read, and are left out"] if bad else []
    base = time_base(np.frombuffer(stamps, np.int64), utc=True)
    entries = Entries(np.zeros(len(stamps), np.int32), np.frombuffer(places, np.int64))
    source = Source(path.stem, "", tuple(fields), _Rows(file).row)
    return IndexedLog(path, "parquet", [source], entries, base, remarks=remarks, close=file.close)


def _stamps(file: Any, time: TimeColumn, is_instant: bool) -> tuple[array[int], array[int], int]:
    """Stamp and place (row group << 32 | row) of each row with a time; how many have none."""
    import pyarrow as pa

    stamps, places = array("q"), array("q")
    bad = 0
    name = file.schema_arrow.field(time.column).name
    for group in range(file.metadata.num_row_groups):
        column = file.read_row_group(group, columns=[name]).column(0)
        if is_instant:
            column = column.cast(pa.timestamp("ns")).cast(pa.int64())
        for row, value in enumerate(column.to_pylist()):
            stamp = value if is_instant else None if value is None else stamp_of(str(value), time.factor)
            if stamp is None:
                bad += 1
            else:
                stamps.append(stamp)
                places.append(group << 32 | row)
    return stamps, places, bad


class _Rows:
    """Rows of the row group that was used last."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self._group = -1
        self._columns: dict[str, list[object]] = {}

    def row(self, place: int) -> Mapping[str, object]:
        """The row at a place, without what is missing."""
        group, row = place >> 32, place & 0xFFFFFFFF
        if group != self._group:
            table = self._file.read_row_group(group)
            self._columns = dict(zip(table.column_names, (column.to_pylist() for column in table.columns), strict=True))
            self._group = group
        return {name: column[row] for name, column in self._columns.items() if column[row] is not None}
