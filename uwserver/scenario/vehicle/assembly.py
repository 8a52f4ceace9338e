"""One vehicle of a scenario from its parts: the vehicle file, `override`, and the sensors that the scenario adds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uwserver.actuators import ActuatorConfig
from uwserver.scenario.files.convert import Node
from uwserver.scenario.files.documents import Document
from uwserver.scenario.files.errors import KeyPath, Problem, Severity
from uwserver.scenario.files.merge import merged
from uwserver.scenario.vehicle.appendage_tables import Ballast, Fin, Foil, Hull, MovingMass, ShaftPropeller
from uwserver.scenario.vehicle.external import ACTIVE_TABLES
from uwserver.scenario.vehicle.tables import AddedMass, Buoyancy, Damping, Lamp, RigidBody, Thruster, ThrusterDevice
from uwserver.sensors import SensorConfig


@dataclass(frozen=True)
class Draft:
    """What could be read of a vehicle, so that one fault does not hide the others. Tables with faults are missing (None).

    Attributes:
        tree: the merged tables, faulty ones too.
        devices: by thruster name, those that could be read.
    """

    tree: Node
    rigid_body: RigidBody | None = None
    buoyancy: Buoyancy | None = None
    added_mass: AddedMass | None = None
    damping: Damping | None = None
    thrusters: Mapping[str, Thruster] = field(default_factory=dict)
    actuators: Mapping[str, ActuatorConfig] = field(default_factory=dict)
    sensors: Mapping[str, SensorConfig] = field(default_factory=dict)
    fins: Mapping[str, Fin] = field(default_factory=dict)
    foils: Mapping[str, Foil] = field(default_factory=dict)
    propellers: Mapping[str, ShaftPropeller] = field(default_factory=dict)
    ballasts: Mapping[str, Ballast] = field(default_factory=dict)
    moving_masses: Mapping[str, MovingMass] = field(default_factory=dict)
    lamps: Mapping[str, Lamp] = field(default_factory=dict)
    hull: Hull | None = None
    devices: Mapping[str, ThrusterDevice] = field(default_factory=dict)

    def names(self, table: str) -> tuple[str, ...]:
        """Names in a table of tables, faulty ones too."""
        return tuple(self.tree.at(table).parts)

    def enabled(self, table: str) -> tuple[str, ...]:
        """As `names`, without those that are taken out."""
        parts = self.tree.at(table).parts.items()
        return tuple(name for name, part in parts if part.at("enabled").value is not False)


@dataclass(frozen=True)
class MergedFile:
    """The merged tables of one vehicle, which remember in which file each key stands.

    Attributes:
        scenario, file: where the keys come from.
        name: of the vehicle in the scenario.
        raw: what came of it.
    """

    scenario: Document
    file: Document
    name: str
    raw: dict[str, Any]

    def problem(self, path: KeyPath, text: str, at: KeyPath | None = None, severity: Severity = "error") -> Problem:
        """A problem in the scenario file if the key (or the nearest table around it) stands there, else in the vehicle file."""
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
        """Where a relative file name at this key starts: beside the file that the key stands in."""
        document = self.file if self._in_scenario(path) is None else self.scenario
        return Path.cwd() if document.path is None else document.path.parent

    def _in_scenario(self, path: KeyPath) -> KeyPath | None:
        prefix: KeyPath = ("vehicles", self.name)
        if path[0] == "sensors" and len(path) > 1 and prefix + path in self.scenario.locations:
            return prefix
        prefix = (*prefix, "override")
        return prefix if prefix + path in self.scenario.locations else None


def merged_file(scenario: Document, name: str, entry: Mapping[str, Any], file: Document) -> MergedFile:
    """The vehicle file with `override` merged in key by key, then the scenario's sensors, each replacing one of the same name whole.

    Of a vehicle without dynamics only what it looks like and what is solid of it is left.
    """
    override = entry.get("override")
    raw = merged(file.raw, override) if isinstance(override, dict) else dict(file.raw)
    added = entry.get("sensors")
    if isinstance(added, dict):
        present = raw.get("sensors")
        raw["sensors"] = {**(present if isinstance(present, dict) else {}), **added}
    if entry.get("kind") == "external":
        raw = {key: table for key, table in raw.items() if key not in ACTIVE_TABLES}
        if isinstance(added, dict):
            raw["sensors"] = dict(added)
    return MergedFile(scenario, file, name, raw)


def drafted(tree: Node, devices: Mapping[str, ThrusterDevice]) -> Draft:
    """A vehicle's tables by their types."""
    parts: dict[str, Any] = {
        table: tree.at(table).value for table in ("rigid_body", "buoyancy", "added_mass", "damping", "hull")
    }
    for table in (
        "thrusters",
        "fins",
        "foils",
        "propellers",
        "ballasts",
        "moving_masses",
        "lamps",
        "actuators",
        "sensors",
    ):
        parts[table] = tree.values(table)
    return Draft(tree, devices=devices, **parts)
