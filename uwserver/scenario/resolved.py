"""What loading a scenario gives: every file read, every reference followed, every check passed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from uwserver.scenario.errors import Problem
from uwserver.scenario.schema import Scenario, VehicleEntry
from uwserver.scenario.vehicle_schema import ThrusterDevice, Vehicle


@dataclass(frozen=True)
class ResolvedVehicle:
    """One vehicle of the scenario.

    Attributes:
        name: its table name.
        entry: its table in the scenario.
        vehicle: the vehicle file with `override` and the entry's sensors merged in, disabled components taken out.
        devices: device of each thruster, by the thruster's name.
    """

    name: str
    entry: VehicleEntry
    vehicle: Vehicle
    devices: Mapping[str, ThrusterDevice]


@dataclass(frozen=True)
class Resolved:
    """A scenario ready to build.

    Attributes:
        name: file stem, or the name given by the builder.
        scenario: the typed file.
        vehicles: in the order of the file.
        path: the file; None for one built in Python.
        warnings: what a user should know, though the scenario runs.
    """

    name: str
    scenario: Scenario
    vehicles: Mapping[str, ResolvedVehicle]
    path: Path | None
    warnings: tuple[Problem, ...]
