"""Names and places of the vehicles that one table with `copies` stands for."""

from __future__ import annotations

import math
from collections.abc import Iterator

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.vehicle.entry import Copies, VehicleEntry
from uwserver.table import Vector3

_AT_THE_ORIGIN = Node((0.0, 0.0, 0.0))


def places(name: str, first: Vector3, copies: Copies | UnsetType) -> Iterator[tuple[str, Vector3]]:
    """Yield name and position in N of each vehicle of a table; the table itself is the only one if it has no copies.

    Args:
        name: of the table.
        first: `position_ned_m` of the table, m.
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
    """Return the table of each single vehicle, by name."""
    each = places(name, entry.position_ned_m, entry.copies)
    return {own_name: replace(entry, position_ned_m=p, copies=UNSET) for own_name, p in each}


def starts(scenario: Node, table: str) -> Iterator[tuple[str, str, Vector3 | None]]:
    """Yield table, name and position of each of the `vehicles` or `objects`; the position is None if it has an error."""
    for key, entry in scenario.at(table).parts.items():
        first = entry.parts.get("position_ned_m", _AT_THE_ORIGIN).value
        copies = entry.at("copies").value
        if copies is None or first is None:
            yield key, key, first
        else:
            yield from ((key, each, place) for each, place in places(key, first, copies))


def check_names(scenario: Node, report: Report) -> None:
    """Report vehicles and objects that have the same name."""
    taken: dict[str, str] = {}
    for table in ("vehicles", "objects"):
        for key, name, _ in starts(scenario, table):
            owner = taken.setdefault(name, key)
            if owner != key:
                report(
                    (table, key),
                    f'"{name}" is already the name of a vehicle or object of the table "{owner}": choose another name',
                )
