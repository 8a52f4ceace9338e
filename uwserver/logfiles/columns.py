"""Columns of a table by their names: their units, and which of them is the time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from uwserver.logfiles.log import LogField
from uwserver.logfiles.si import is_known
from uwserver.logfiles.timebase import utc_ns

_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*)\s*[\])]\s*$")
_SUFFIXES = {
    "mps": "m/s", "mps2": "m/s^2", "radps": "rad/s", "degps": "deg/s", "pa": "Pa", "hpa": "hPa", "kpa": "kPa", "degc": "degC", "v": "V",
    "a": "A", "hz": "Hz", "deg": "deg", "rad": "rad", "m": "m", "cm": "cm", "mm": "mm", "km": "km", "ft": "ft", "s": "s", "ms": "ms",
    "us": "us", "ns": "ns", "kn": "kn", "rpm": "rpm",
}  # fmt: skip
_TIMES = re.compile(r"t|time|timestamp|stamp|t_sent|time_boot|seconds|sec|datetime|date_time|utc", re.IGNORECASE)
_FACTORS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}
_LAST_NS = float(1 << 62)


class TimeColumn(NamedTuple):
    """Which column is the time, and how many ns its numbers count; 0 where they say it by their size."""

    column: int
    factor: int


def field_of(name: str, type_: str, unit: str = "", frame: str = "") -> LogField:
    """A column; its unit, where nobody says it, from its name: ``depth_m``, ``depth [m]``."""
    if not unit:
        if bracketed := _BRACKETS.match(name):
            unit = bracketed[2] if is_known(bracketed[2]) else _SUFFIXES.get(bracketed[2].lower(), "")
        elif "_" in name:
            unit = _SUFFIXES.get(name.rpartition("_")[2].lower(), "")
    return LogField(name, type_, unit, frame)


def time_column(fields: Sequence[LogField]) -> TimeColumn | None:
    """The first column whose name says that it is the time; None without one."""
    for k, field in enumerate(fields):
        bracketed = _BRACKETS.match(field.name)
        stem = bracketed[1] if bracketed else field.name
        if field.unit in _FACTORS:
            short = re.sub(rf"_{field.unit}$", "", stem, flags=re.IGNORECASE)
            if _TIMES.fullmatch(short):
                return TimeColumn(k, _FACTORS[field.unit])
        if _TIMES.fullmatch(stem):
            return TimeColumn(k, _FACTORS.get(field.unit, 0))
    return None


def stamp_of(text: str, factor: int) -> int | None:
    """ns of a cell: a number, or an instant (RFC 3339); None when it is neither."""
    try:
        number = float(text)
    except ValueError:
        return utc_ns(text)
    if factor == 0:
        # Seconds since 1970 have 10 digits, milliseconds 13, microseconds 16, nanoseconds 19.
        size = abs(number)
        factor = 1_000_000_000 if size < 1e11 else 1_000_000 if size < 1e14 else 1000 if size < 1e17 else 1
    if not abs(number) * factor < _LAST_NS:
        return None
    # Whole numbers stay exact.
    return int(text) * factor if re.fullmatch(r"\s*[+-]?\d+\s*", text) else round(number * factor)
