"""Finds the units of table columns, and the time column, from the column names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from uwserver.logfiles.log import LogError, LogField
from uwserver.logfiles.si import is_known
from uwserver.logfiles.timebase import LAST_NS, utc_ns

_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*)\s*[\])]\s*$")
_SUFFIXES = {
    "mps": "m/s", "mps2": "m/s^2", "radps": "rad/s", "degps": "deg/s", "pa": "Pa", "hpa": "hPa", "kpa": "kPa", "degc": "degC", "v": "V",
    "a": "A", "hz": "Hz", "deg": "deg", "rad": "rad", "m": "m", "cm": "cm", "mm": "mm", "km": "km", "ft": "ft", "s": "s", "ms": "ms",
    "us": "us", "ns": "ns", "kn": "kn", "rpm": "rpm",
}  # fmt: skip
_TIMES = re.compile(r"t|time|timestamp|stamp|t_sent|time_boot|seconds|sec|datetime|date_time|utc", re.IGNORECASE)
_FACTORS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}


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
