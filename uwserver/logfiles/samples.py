"""Samples of ports from a log: names, units and axes as a mapping says."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from uwserver.logfiles.log import Datum, Log, member
from uwserver.logfiles.mapping import Entry, Mapping, PortSource, Value
from uwserver.logfiles.si import Scale, scale_of

_Part = tuple[str, Scale, float]


def port_samples(
    log: Log,
    mapping: Mapping,
    ports: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Datum]:
    """Data under the names of ports, in the order of their times: ``Datum(t_ns, port, {field: number, text or tuple})`` in SI.

    What is no finite number is None; a datum that has nothing of a port gives no sample.

    Raises:
        LogError: the log is damaged.
    """
    takers: dict[str, list[tuple[str, PortSource, dict[str, list[_Part] | _Part]]]] = {}
    for name, source in mapping.ports.items():
        if ports is None or name in ports:
            takers.setdefault(source.topic, []).append((name, source, _parts(source)))
    for t_ns, topic, datum in log.read(set(takers), start_ns, end_ns):
        for name, source, parts in takers[topic]:
            if source.where and any(member(datum, field) != wanted for field, wanted in source.where.items()):
                continue
            found = {
                field: tuple(_value(datum, p) for p in part) if isinstance(part, list) else _value(datum, part)
                for field, part in parts.items()
            }
            if any(value is not None for value in found.values()):
                yield Datum(t_ns, name, found)


def _parts(source: PortSource) -> dict[str, list[_Part] | _Part]:
    def part(entry: Entry) -> _Part:
        value = Value(entry) if isinstance(entry, str) else entry
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
    if isinstance(value, int | float | np.number):
        try:
            number = (float(value) * scale.factor + scale.offset) * factor
        except OverflowError:
            return None
        return number if math.isfinite(number) else None
    return None
