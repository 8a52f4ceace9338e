"""Makes one table of each topic, and writes the tables as CSV, Parquet, NetCDF and MATLAB files."""

from __future__ import annotations

import base64
import csv
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from uwserver.logfiles.log import Log, LogField
from uwserver.logfiles.ports import number
from uwserver.logfiles.timebase import utc_text

TIME = "time_ns"
"""Name of the first column of every table: ns on the log's time base."""
_MOST_ITEMS = 4096
"""Longer lists become text."""
_INT = 1 << 63
_MATLAB_NAME = 31


class Column(NamedTuple):
    """One column: name, unit, frame, and values: (n,) or (n, k) of float64, int64 or bool, or a list of n texts."""

    name: str
    unit: str
    frame: str
    values: NDArray[Any] | list[str]


class TopicTable(NamedTuple):
    """All data of a topic; the first column is the time."""

    topic: str
    schema: str
    columns: tuple[Column, ...]


def topic_tables(log: Log, topics: Collection[str] | None = None) -> Iterator[TopicTable]:
    """Yield a table for each topic that has data. Only one topic is in memory at a time.

    Raises:
        LogError: the log is damaged.
    """
    for name, topic in log.topics.items():
        if topics is not None and name not in topics:
            continue
        times: list[int] = []
        rows: list[dict[str, object]] = []
        for datum in log.read({name}):
            times.append(datum.t_ns)
            rows.append(dict(flattened(datum.value)))
        if not rows:
            continue
        about = {_short(field.name): field for field in topic.fields}
        columns = [Column(TIME, "ns", "", np.array(times, np.int64))]
        for column in dict.fromkeys(key for row in rows for key in row):
            said = about.get(column, LogField(column, ""))
            name_out = column if column != TIME else f"{column}_"
            unit = said.unit or ("ns" if column.endswith("_ns") else "")
            columns.append(Column(name_out, unit, said.frame, _values([row.get(column) for row in rows])))
        yield TopicTable(name, topic.schema, tuple(columns))


def flattened(value: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield the leaves of a nested message with dotted names, without the prefix ``value.`` of our own recordings."""
    for key, entry in value.items():
        name = f"{prefix}{key}"
        if isinstance(entry, Mapping) and entry:
            yield from flattened(entry, f"{name}.")
        else:
            yield _short(name), entry


def file_names(topics: Sequence[str]) -> dict[str, str]:
    """Return a unique file name for each topic, of letters, digits and ``_`` only, so that no topic name acts as a path."""
    found: dict[str, str] = {}
    for topic in topics:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", topic).strip("_")[:100] or "topic"
        taken = {name.lower() for name in found.values()}
        candidates = (plain, *(f"{plain}_{k}" for k in range(2, len(topics) + 3)))
        found[topic] = next(name for name in candidates if name.lower() not in taken)
    return found


def _short(name: str) -> str:
    return name.removeprefix("value.")


def _values(cells: list[object]) -> NDArray[Any] | list[str]:
    """Return the cells of a column as one array, if all are numbers or None, which becomes NaN; else as texts."""
    if any(isinstance(cell, list | tuple | np.ndarray) for cell in cells):
        return _lists(cells)
    if all(isinstance(cell, bool) for cell in cells):
        return np.array(cells, np.bool_)
    if all(isinstance(cell, int) and not isinstance(cell, bool) and -_INT <= cell < _INT for cell in cells):
        return np.array(cells, np.int64)
    if all(cell is None or isinstance(cell, int | float) for cell in cells):
        return np.array([number(cell) for cell in cells], np.float64)
    return [_text(cell) for cell in cells]


def _lists(cells: list[object]) -> NDArray[Any] | list[str]:
    lengths = {len(cell) for cell in cells if isinstance(cell, list | tuple | np.ndarray)}
    if len(lengths) == 1 and 0 < (length := lengths.pop()) <= _MOST_ITEMS:
        rows = [cell if isinstance(cell, list | tuple | np.ndarray) else [None] * length for cell in cells]
        if all(x is None or isinstance(x, int | float | np.number) for row in rows for x in row):
            return np.array([[number(x) for x in row] for row in rows], np.float64)
    return [_text(cell) for cell in cells]


def _text(cell: object) -> str:
    if cell is None:
        return ""
    if isinstance(cell, str):
        return cell
    if isinstance(cell, bytes | memoryview | bytearray):
        return base64.b64encode(cell).decode()
    return msgspec.json.encode(cell, enc_hook=_plain).decode()


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


# -- files ------------------------------------------------------------------------------------------------------------------------------


def write_csv(log: Log, tables: Iterable[TopicTable], folder: Path) -> None:
    """Write one file per topic, with ``name [unit]`` in the header, one column per list item, and all else, such as frames, in ``log.json``.

    Raises:
        OSError: the folder exists already, or cannot be written.
    """
    folder.mkdir(parents=True)
    names = file_names(list(log.topics))
    about = []
    for table in tables:
        columns = list(_single(table.columns))
        with (folder / f"{names[table.topic]}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([c.name if c.unit in ("", "1", "ns") else f"{c.name} [{c.unit}]" for c in columns])
            writer.writerows(
                zip(*(c.values if isinstance(c.values, list) else c.values.tolist() for c in columns), strict=True)
            )
        fields = [{"name": c.name, "unit": c.unit, "frame": c.frame} for c in table.columns]
        about.append(
            {"topic": table.topic, "schema": table.schema, "file": f"{names[table.topic]}.csv", "fields": fields}
        )
    whole = {**_origin(log), "topics": about}
    (folder / "log.json").write_bytes(msgspec.json.format(msgspec.json.encode(whole), indent=2))


def write_parquet(log: Log, tables: Iterable[TopicTable], folder: Path) -> None:
    """Write one file per topic, with ``unit`` and ``frame`` in the metadata of each column, and all else in the metadata of the file.

    Raises:
        OSError: the folder exists already, or cannot be written.
        ImportError: pyarrow is not installed.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder.mkdir(parents=True)
    names = file_names(list(log.topics))
    for table in tables:
        fields, arrays = [], []
        for column in table.columns:
            array = _arrow(pa, column)
            said = {key: value for key, value in (("unit", column.unit), ("frame", column.frame)) if value}
            fields.append(pa.field(column.name, array.type, metadata=said or None))
            arrays.append(array)
        about = {
            key: str(value) for key, value in {**_origin(log), "topic": table.topic, "schema": table.schema}.items()
        }
        made = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=about))
        pq.write_table(made, folder / f"{names[table.topic]}.parquet")


def write_netcdf(log: Log, tables: Iterable[TopicTable], file: Path) -> None:
    """Write NetCDF 4 with one group per topic and the attributes ``units`` and ``frame``. Times count from the log's epoch, as in the CF conventions.

    Raises:
        OSError: the file cannot be written.
        ImportError: h5netcdf is not installed.
    """
    import h5netcdf
    import h5py

    names = file_names(list(log.topics))
    since = f"nanoseconds since {utc_text(log.epoch_ns)}" if log.epoch_ns is not None else "ns"
    with h5netcdf.File(str(file), "w") as whole:
        whole.attrs.update(_origin(log))
        for table in tables:
            group = whole.create_group(names[table.topic])
            group.attrs["topic"], group.attrs["schema"] = table.topic, table.schema
            group.dimensions = {"time": len(table.columns[0].values)}
            for k, column in enumerate(table.columns):
                values: Any = np.array(column.values, object) if isinstance(column.values, list) else column.values
                dimensions = ["time"]
                if values.ndim == 2:
                    group.dimensions[f"n{k}"] = values.shape[1]
                    dimensions.append(f"n{k}")
                if values.dtype == np.bool_:
                    values = values.astype(np.int8)
                kind = values.dtype if values.dtype != object else h5py.string_dtype()
                name = "time" if k == 0 else column.name.replace("/", "_")
                variable = group.create_variable(name, tuple(dimensions), dtype=kind, data=values)
                variable.attrs["units"] = since if k == 0 else column.unit or "1"
                if column.frame:
                    variable.attrs["frame"] = column.frame


def write_mat(log: Log, tables: Iterable[TopicTable], file: Path) -> None:
    """Write MATLAB 5 with one struct per topic and one array per field; its members ``units`` and ``frames`` hold those of the fields.

    Raises:
        OSError: the file cannot be written.
    """
    from scipy.io import savemat

    names = file_names(list(log.topics))
    whole: dict[str, Any] = {"log": _origin(log)}
    for table in tables:
        content: dict[str, Any] = {"topic": table.topic}
        units: dict[str, str] = {}
        frames: dict[str, str] = {}
        keys = file_names([column.name for column in table.columns])
        for column in table.columns:
            key = _matlab(keys[column.name])
            is_text = isinstance(column.values, list)
            content[key] = np.array(column.values, object) if is_text else column.values
            units[key] = column.unit or "1"
            if column.frame:
                frames[key] = column.frame
        content["units"] = units
        if frames:
            content["frames"] = frames
        whole[_matlab(names[table.topic])] = content
    savemat(str(file), whole, long_field_names=True, oned_as="column")


def _single(columns: Iterable[Column]) -> Iterator[Column]:
    """Yield columns with one value per row: an array column is split into its items."""
    for column in columns:
        if isinstance(column.values, list) or column.values.ndim == 1:
            yield column
        else:
            for k in range(column.values.shape[1]):
                yield Column(f"{column.name}.{k}", column.unit, column.frame, column.values[:, k])


def _arrow(pa: Any, column: Column) -> Any:
    values = column.values
    if isinstance(values, list) or values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])


def _matlab(name: str) -> str:
    return (name if name[:1].isalpha() else f"x{name}")[: 2 * _MATLAB_NAME]


def _origin(log: Log) -> dict[str, Any]:
    return {"source": log.path.name, "kind": log.kind, "epoch_utc": "" if log.epoch_ns is None else utc_text(log.epoch_ns),
            "epoch_ns": -1 if log.epoch_ns is None else log.epoch_ns, "remarks": "; ".join(log.remarks)}  # fmt: skip
