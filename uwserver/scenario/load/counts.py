"""How many of anything a scenario may have: a small file can ask for more than is ever built."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.documents import Document
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.files.merge import named
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.tables import VehicleFile

MOST_BODIES = 2000
"""Vehicles, with all copies, and objects; also those that are not present at the start."""
MOST_STRUCTURES = 2000
MOST_COMPONENTS = 100_000
"""Sensors with their further streams and modifiers, and actuators, of all vehicles."""


def check_tables(document: Document) -> None:
    """Before anything that a scenario names is read.

    Raises:
        ScenarioError: more vehicles and objects, or structures, than there may be.
    """
    vehicles, objects = named(document.raw, "vehicles"), named(document.raw, "objects")
    copies = sum(_copies(entry) for entry in vehicles.values())
    bodies, structures = copies + len(objects), len(named(document.raw, "structures"))
    if bodies > MOST_BODIES:
        key = "vehicles" if copies >= len(objects) else "objects"
        text = f"{copies} vehicles, copies counted, and {len(objects)} objects: at most {MOST_BODIES} together"
        raise ScenarioError([document.problem((key,), f"{text}; spread them over several servers")])
    if structures > MOST_STRUCTURES:
        text = f"{structures} structures: at most {MOST_STRUCTURES}; put several shapes into one mesh"
        raise ScenarioError([document.problem(("structures",), text)])


def check_components(scenario: Scenario, files: Mapping[str, VehicleFile], report: Report) -> None:
    """Before any is built.

    Args:
        scenario: whose vehicles may have copies.
        files: of its tables of vehicles, by name.
        report: takes in the fault.
    """
    counts = {name: _components(file) * _copies_of(scenario, name) for name, file in files.items()}
    if sum(counts.values()) > MOST_COMPONENTS:
        most = max(counts, key=counts.__getitem__)
        text = f"{sum(counts.values())} sensors, streams, modifiers and actuators in all vehicles, {counts[most]} of them here"
        report(("vehicles", most), f"{text}: at most {MOST_COMPONENTS}")


def _copies(entry: Any) -> int:
    """As the file says, which may be anything; what is no count is told later."""
    copies = entry.get("copies") if isinstance(entry, Mapping) else None
    count = copies.get("count") if isinstance(copies, Mapping) else 1
    return max(1, count) if isinstance(count, int) else 1


def _copies_of(scenario: Scenario, name: str) -> int:
    copies = scenario.vehicles[name].copies
    return getattr(copies, "count", 1)


def _components(file: VehicleFile) -> int:
    streams = [sensor.streams for sensor in file.sensors.values()]
    modifiers = [sensor.modifiers for sensor in file.sensors.values()]
    modifiers += [stream.modifiers for each in streams for stream in each.values()]
    return len(file.sensors) + len(file.actuators) + sum(map(len, streams)) + sum(map(len, modifiers))
