"""One vehicle of a scenario: its table, its copies, and its merge with the vehicle file that the table names."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import UNSET, Meta, UnsetType, field
from msgspec.structs import replace

from uwserver.autopilot.config import AutopilotConfig
from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.files.documents import Document, merged
from uwserver.scenario.files.errors import KeyPath, Problem, Severity
from uwserver.scenario.vehicle.external import DYNAMIC_TABLES, Following
from uwserver.sensors import SensorConfig
from uwserver.sensors.truth import Truth
from uwserver.table import Name, Positive, Table, Vector3


class Copies(Table, kw_only=True, frozen=True):
    """Several vehicles from one table, ``<name>_1``, ``<name>_2`` and so on, in rows to the north and columns to the east.

    Attributes:
        count: how many vehicles.
        columns: vehicles in a row; default: about as many as there are rows.
        spacing_m: distance of rows and of columns; the first vehicle is at `position_ned_m`.
    """

    count: Annotated[int, Meta(ge=1, le=1000)]
    columns: Annotated[int, Meta(ge=1)] | UnsetType = UNSET
    spacing_m: tuple[Positive, Positive] = (5.0, 5.0)


class VehicleEntry(Following, kw_only=True, frozen=True):
    """One vehicle of the scenario, or several copies of it.

    Attributes:
        kind: "simulated", or "external" for a vehicle that follows poses from a log or another source; the keys from `log` to `rate_hz` are for that.
        model: name of a shipped vehicle file, or the path of one relative to the scenario file.
        copies: several vehicles in a grid; default: one vehicle, with the name of the table.
        present: false leaves it out at the start; ``world/spawn`` can add vehicles like it later.
        override: keys of the vehicle file with other values for this vehicle.
        sensors: added to those of the vehicle file. One with the same name replaces it; ``enabled = false`` removes it.
        autopilot: the built-in autopilot; default: none.
    """

    model: Name
    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    attitude_rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    velocity_frd_mps: Vector3 = (0.0, 0.0, 0.0)
    angular_velocity_frd_degps: Vector3 = (0.0, 0.0, 0.0)
    copies: Copies | UnsetType = UNSET
    present: bool = True
    truth: Truth | UnsetType = UNSET
    override: dict[str, Any] = field(default_factory=dict)
    sensors: dict[str, SensorConfig] = field(default_factory=dict)
    autopilot: AutopilotConfig | UnsetType = UNSET


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


@dataclass(frozen=True)
class MergedFile:
    """The merged tables of one vehicle, with the two files that its keys come from.

    Attributes:
        scenario, file: the scenario file and the vehicle file.
        name: of the vehicle in the scenario.
        raw: the merged tables.
    """

    scenario: Document
    file: Document
    name: str
    raw: dict[str, Any]

    def problem(self, path: KeyPath, text: str, at: KeyPath | None = None, severity: Severity = "error") -> Problem:
        """Return a problem, placed in the scenario file if the key (or the nearest table around it) is there, else in the vehicle file."""
        place = path if at is None else at
        while place:
            prefix = self._in_scenario(place)
            if prefix is not None:
                return self.scenario.problem(prefix + path, text, prefix + place, severity)
            if place in self.file.locations:
                break
            place = place[:-1]
        return self.file.problem(path, text, place, severity)

    def folder_of(self, path: KeyPath) -> Path:
        """Return the folder where a relative file name at this key starts: that of the file which has the key."""
        return (self.file if self._in_scenario(path) is None else self.scenario).folder

    def _in_scenario(self, path: KeyPath) -> KeyPath | None:
        prefix: KeyPath = ("vehicles", self.name)
        if path[0] == "sensors" and len(path) > 1 and prefix + path in self.scenario.locations:
            return prefix
        prefix = (*prefix, "override")
        return prefix if prefix + path in self.scenario.locations else None


def merged_file(scenario: Document, name: str, entry: Mapping[str, Any], file: Document) -> MergedFile:
    """Merge `override` into the vehicle file key by key, then add the scenario's sensors, which replace sensors of the same name as a whole.

    Of an external vehicle, which has no dynamics, only its looks and its solid shapes are left.
    """
    override = entry.get("override")
    raw = merged(file.raw, override) if isinstance(override, dict) else dict(file.raw)
    added = entry.get("sensors")
    if isinstance(added, dict):
        present = raw.get("sensors")
        raw["sensors"] = {**(present if isinstance(present, dict) else {}), **added}
    if entry.get("kind") == "external":
        raw = {key: table for key, table in raw.items() if key not in DYNAMIC_TABLES}
        if isinstance(added, dict):
            raw["sensors"] = dict(added)
    return MergedFile(scenario, file, name, raw)
