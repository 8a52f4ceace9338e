"""Several vehicles alike from one table: their names and places."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from uwserver.scenario.files.convert import Report, convert, silent
from uwserver.scenario.files.merge import named
from uwserver.scenario.vehicle.entry import Copies, VehicleEntry
from uwserver.table import Vector3


def places(name: str, first: Vector3, copies: Copies | UnsetType) -> Iterator[tuple[str, Vector3]]:
    """Name and position in N of each vehicle of a table; of the table alone if it has no copies.

    Args:
        name: of the table.
        first: `position_ned_m`, m.
        copies: of the table.
    """
    if isinstance(copies, UnsetType):
        yield name, first
        return
    columns = math.ceil(math.sqrt(copies.count)) if copies.columns is UNSET else int(copies.columns)
    for k in range(copies.count):
        row, column = divmod(k, columns)
        north, east = row * copies.spacing_m[0], column * copies.spacing_m[1]
        yield f"{name}_{k + 1}", (first[0] + north, first[1] + east, first[2])


def entries(name: str, entry: VehicleEntry) -> dict[str, VehicleEntry]:
    """The table of each vehicle, none of which has copies any more."""
    return {
        each: replace(entry, position_ned_m=p, copies=UNSET)
        for each, p in places(name, entry.position_ned_m, entry.copies)
    }


def raw_places(raw: Mapping[str, Any], table: str) -> Iterator[tuple[str, str, object]]:
    """Table, name and position of each vehicle or object of a file that may have faults; what is no position is given as it stands."""
    for key, entry in named(raw, table).items():
        if not isinstance(entry, dict):
            continue
        p = entry.get("position_ned_m", (0.0, 0.0, 0.0))
        copies = convert(entry["copies"], Copies, (), silent) if "copies" in entry else None
        first = convert(p, Vector3, (), silent)
        if copies is None or first is None:
            yield key, key, p
        else:
            yield from ((key, each, place) for each, place in places(key, first, copies))


def check_names(raw: Mapping[str, Any], report: Report) -> None:
    """No two vehicles or objects may have one name."""
    taken: dict[str, str] = {}
    for table in ("vehicles", "objects"):
        for key, name, _ in raw_places(raw, table):
            owner = taken.setdefault(name, key)
            if owner != key:
                report((table, key), f'"{name}" is a vehicle of the table "{owner}" already: choose another name')
