"""One vehicle of a scenario: its table, its copies, and its merge with the vehicle file that the table names.

An external vehicle follows poses from a log or another source.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, UnsetType, field
from msgspec.structs import replace

from uwserver.autopilot.config import AutopilotConfig
from uwserver.scenario.files.convert import Node, Report, check_known
from uwserver.scenario.files.documents import Document, merged
from uwserver.scenario.files.errors import KeyPath, Problem, Severity
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.earth import instant
from uwserver.sensors import ModemTable, SensorConfig
from uwserver.sensors.truth import Truth
from uwserver.table import Name, NonNegative, Positive, Table, Vector3
from uwserver.world.external.pose_source import PREDICT_S
from uwserver.world.external.track import MAX_GAP_S

DYNAMIC_TABLES = (
    "mounts", "foils", "ballasts", "moving_masses", "actuators", "sensors", "autopilot", "lamps", "published",
)  # fmt: skip
"""Tables of a vehicle file that an external vehicle does not use. What remains is its looks, its solid shapes, and the parts that turn."""
COLOURS: tuple[Vector3, ...] = (
    (0.05, 0.55, 0.95), (0.95, 0.35, 0.05), (0.15, 0.75, 0.25), (0.85, 0.15, 0.65), (0.95, 0.80, 0.10), (0.45, 0.35, 0.95),
)  # fmt: skip
"""Colours that external vehicles without a `colour` get in turn (linear red, green, blue)."""
_AT_THE_ORIGIN = Node((0.0, 0.0, 0.0))


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


Part = Annotated[float, Meta(ge=0.0, le=1.0)]


class Following(Table, kw_only=True, frozen=True):
    """Keys of a vehicle of ``kind = "external"``: where its poses come from, and how it appears to others.

    Without `log` the poses come as commands to its port ``<name>/pose``, from any adapter.

    Attributes:
        log: recording or log file, relative to this file, from which the poses are read before the run.
        track: topic of the log; in a recording the path of a port with p_NB and q_NB, such as ``rov/truth/pose`` or ``rov/autopilot/state``.
        mapping: TOML file that says how poses are made from the topics of the log; `uwserver log FILE --mapping` prints one to start from.
        start: which moment of the log is time 0 of the scenario: "first" for the first pose of the track, a number of seconds on the log's own
            clock, or an instant in UTC (``2026-01-01T00:00:00Z``).
        offset_s: delay of all poses.
        speed: seconds of the log per second of simulation time.
        outside: where the vehicle is before the first pose, after the last one and in gaps: nowhere ("hide"), or at its last place ("hold").
        max_gap_s: longest gap between two poses over which the pose is interpolated.
        predict_s: how long it moves on at constant velocity after a pose that came as a command.
        solid: whether it can be touched and sensors of others see it. If not, it is a ghost, which viewers draw.
        colour: red, green, blue, 0..1, linear, of a ghost and of its trail.
        compare_with: name of another vehicle; the port ``<name>/difference`` gives the difference to its pose.
        rate_hz: of ``<name>/state`` and ``<name>/difference``; divides the physics rate.
    """

    kind: Literal["simulated", "external"] = "simulated"
    log: Name | UnsetType = UNSET
    track: Name | UnsetType = UNSET
    mapping: Name | UnsetType = UNSET
    start: float | str = "first"
    offset_s: float = 0.0
    speed: Positive = 1.0
    outside: Literal["hide", "hold"] = "hide"
    max_gap_s: Positive = MAX_GAP_S
    predict_s: NonNegative = PREDICT_S
    solid: bool = False
    colour: tuple[Part, Part, Part] | UnsetType = UNSET
    compare_with: Name | UnsetType = UNSET
    rate_hz: Positive | UnsetType = UNSET

    @property
    def is_external(self) -> bool:
        """Whether it follows poses, and so has no dynamics."""
        return self.kind == "external"


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


# -- copies -----------------------------------------------------------------------------------------------------------------------------


def places(name: str, first: Vector3, copies: Copies | UnsetType) -> Iterator[tuple[str, Vector3]]:
    """Yield name and position in N of each vehicle of a table; the table itself is the only one if it has no copies.

    Args:
        name: name of the table.
        first: `position_ned_m` of the table, m.
        copies: `copies` of the table.
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


# -- merging ----------------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class MergedFile:
    """The merged tables of one vehicle, with the two files that its keys come from.

    Attributes:
        scenario, file: the scenario file and the vehicle file.
        name: name of the vehicle in the scenario.
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


# -- checks of external vehicles --------------------------------------------------------------------------------------------------------


def check_external(name: str, scenario: Node, report: Report) -> None:
    """Check that the keys of a vehicle's table fit its kind.

    Args:
        name: name of the table.
        scenario: the scenario file.
        report: called for errors.
    """
    node = scenario.at("vehicles", name)
    path: KeyPath = ("vehicles", name)
    if node.at("kind").value != "external":
        for key in Following.__struct_fields__:
            if key in node.parts and key != "kind":
                report((*path, key), f'"{key}" is for vehicles of kind = "external"')
        return
    for sensor_name, sensor in node.values("sensors").items():
        if not isinstance(sensor, ModemTable):
            report(
                (*path, "sensors", sensor_name),
                "an external vehicle measures nothing: the only sensors that it can carry are modems; remove this one",
            )
    for key in ("autopilot", "velocity_frd_mps", "angular_velocity_frd_degps"):
        if key in node.parts:
            report((*path, key), f'"{key}" is for simulated vehicles: an external one follows poses; remove this key')
    _check_source(node, path, report)
    world, rate = scenario.at("world").value, node.at("rate_hz").value
    if world is not None and rate is not None:
        check_rate(rate, world.rate_hz, (*path, "rate_hz"), report)
    other = node.at("compare_with").value
    if other == name:
        report((*path, "compare_with"), "it cannot be compared with itself: name another vehicle")
    elif other is not None:
        check_known(other, scenario.names("vehicles"), "vehicle", (*path, "compare_with"), report)


def _check_source(node: Node, path: KeyPath, report: Report) -> None:
    logged = "log" in node.parts
    for key in ("track", "mapping", "start", "offset_s", "speed"):
        if key in node.parts and not logged:
            report(
                (*path, key),
                f'"{key}" is for poses from a log: name its file by log = "...", or remove this key if the poses come as commands',
            )
    if logged and "predict_s" in node.parts:
        report(
            (*path, "predict_s"),
            '"predict_s" is for poses that come as commands: in a log the next pose is known; remove this key',
        )
    if logged and node.at("copies").value is not None:
        report((*path, "copies"), "all copies would follow the same log, at the same place: remove copies")
    start = node.at("start").value
    if isinstance(start, str) and start != "first":
        try:
            instant(start)
        except ValueError:
            text = 'start is "first", a number of seconds on the clock of the log, or an instant "2026-01-01T00:00:00Z"'
            report((*path, "start"), f'{text}, not "{start}"')
