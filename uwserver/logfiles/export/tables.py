"""Makes one table of each topic, for CSV, Parquet, NetCDF and MATLAB files."""

from __future__ import annotations

import base64
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from uwserver.logfiles.log import Log, LogField
from uwserver.logfiles.samples import number

TIME = "time_ns"
"""Name of the first column of every table: ns on the log's time base."""
_MOST_ITEMS = 4096
"""Longer lists become text."""
_INT = 1 << 63


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
