"""Reads the samples of ports from a log, with the names, units and axes that a mapping gives."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from uwserver.logfiles.log import Datum, Log, matches, member
from uwserver.logfiles.mapping import Entry, Mapping, PortMapping, value_of
from uwserver.logfiles.si import Scale, scale_of

_Part = tuple[str, Scale, float]
"""Name of a log field, its conversion to SI, and the mapping's own factor."""


def port_samples(
    log: Log,
    mapping: Mapping,
    ports: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Datum]:
    """Yield samples of ports in the order of their times: ``Datum(t_ns, port, {field: number, text or tuple})``, in SI.

    A value that is not a finite number is None. A datum without any value of a port gives no sample.

    Raises:
        LogError: the log is damaged.
    """
    by_topic: dict[str, list[tuple[str, PortMapping, dict[str, list[_Part] | _Part]]]] = {}
    for name, source in mapping.ports.items():
        if ports is None or name in ports:
            by_topic.setdefault(source.topic, []).append((name, source, _parts(source)))
    for t_ns, topic, datum in log.read(set(by_topic), start_ns, end_ns):
        for name, source, parts in by_topic[topic]:
            if matches(datum, source.where):
                found = {
                    field: tuple(_value(datum, p) for p in part) if isinstance(part, list) else _value(datum, part)
                    for field, part in parts.items()
                }
                if any(value is not None for value in found.values()):
                    yield Datum(t_ns, name, found)


def _parts(source: PortMapping) -> dict[str, list[_Part] | _Part]:
    def part(entry: Entry) -> _Part:
        value = value_of(entry)
        return value.field, scale_of(value.unit or ""), value.scale

    return {
        field: [part(entry) for entry in entries] if isinstance(entries, list) else part(entries)
        for field, entries in source.fields.items()
    }


def _value(datum: Any, part: _Part) -> object:
    field, scale, factor = part
    value = member(datum, field)
    if isinstance(value, bool | str):
        return value
    converted = (number(value) * scale.factor + scale.offset) * factor
    return converted if math.isfinite(converted) else None


def number(value: object) -> float:
    """Return a number of a log; NaN for everything else."""
    try:
        return float(value) if isinstance(value, int | float | np.number) else math.nan
    except OverflowError:
        return math.nan
