"""Limits on the numbers of things in a scenario: a small file can ask for more than can be built."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uwserver.modifiers import Delay
from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.documents import Document
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.files.merge import named
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.sensor_checks import traits_of
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.sensors import SensorConfig

MOST_BODIES = 2000
"""Most vehicles, copies included, and objects together; those that are not present at the start count too."""
MOST_STRUCTURES = 2000
MOST_WAITING = 512 << 20
"""Most bytes of readings, of all sensors, that are measured but not delivered yet."""
_READING, _SIGMAS = 2048, 6.0
"""Bytes of a reading without its pictures (1 to 2 kB were measured), and standard deviations of jitter that are counted."""
MOST_COMPONENTS = 100_000
"""Most sensors, further streams, modifiers and actuators of all vehicles together."""


def check_tables(document: Document) -> None:
    """Check the numbers of vehicles, objects and structures, before any file that the scenario names is read.

    Raises:
        ScenarioError: there are too many.
    """
    vehicles, objects = named(document.raw, "vehicles"), named(document.raw, "objects")
    copies = sum(_copies(entry) for entry in vehicles.values())
    bodies, structures = copies + len(objects), len(named(document.raw, "structures"))
    if bodies > MOST_BODIES:
        key = "vehicles" if copies >= len(objects) else "objects"
        text = f"{copies} vehicles, copies included, and {len(objects)} objects; at most {MOST_BODIES} together are allowed"
        raise ScenarioError([document.problem((key,), f"{text}: spread them over several servers")])
    if structures > MOST_STRUCTURES:
        text = f"{structures} structures; at most {MOST_STRUCTURES} are allowed: put several shapes into one mesh"
        raise ScenarioError([document.problem(("structures",), text)])


def check_components(scenario: Scenario, files: Mapping[str, VehicleFile], report: Report) -> None:
    """Check the number of components of all vehicles, before any is built.

    Args:
        scenario: typed; its vehicles may have copies.
        files: vehicle file of each of its vehicle tables, by name.
        report: called for the error.
    """
    counts = {name: _components(file) * _copies_of(scenario, name) for name, file in files.items()}
    if sum(counts.values()) > MOST_COMPONENTS:
        most = max(counts, key=counts.__getitem__)
        text = f"all vehicles have {sum(counts.values())} sensors, streams, modifiers and actuators, {counts[most]} of them here"
        report(("vehicles", most), f"{text}; at most {MOST_COMPONENTS} are allowed")


def check_delays(scenario: Scenario, files: Mapping[str, VehicleFile], report: Report) -> None:
    """Check the memory for readings that are measured but not delivered yet: those of the latency of each sensor.

    Args:
        scenario, files, report: as for `check_components`.
    """
    waiting = {
        (vehicle, name): _copies_of(scenario, vehicle)
        * _delay_of(sensor)
        * sensor.rate_hz
        * (_READING + traits_of(sensor).picture_bytes)
        for vehicle, file in files.items()
        for name, sensor in file.sensors.items()
    }
    total = sum(waiting.values())
    if total > MOST_WAITING:
        vehicle, name = max(waiting, key=waiting.__getitem__)
        sensor = files[vehicle].sensors[name]
        text = (
            f"{sensor.rate_hz:g} readings a second wait in memory for {_delay_of(sensor):g} s; those of all sensors take "
            f"about {total / 2**20:.0f} MB, at most {MOST_WAITING >> 20} are allowed: lower the latency or the rate"
        )
        report(("vehicles", vehicle, "sensors", name), text)


def _delay_of(sensor: SensorConfig) -> float:
    """Return the longest delay of its streams, s."""
    sides = [sensor.modifiers, *(stream.modifiers for stream in sensor.streams.values())]
    more = [sum(m.latency_s + _SIGMAS * m.jitter_s for m in side.values() if isinstance(m, Delay)) for side in sides]
    return (sensor.latency_s or 0.0) + max(more)


def _copies(entry: Any) -> int:
    """Return the number of copies that raw tables ask for. The tables may hold anything; a wrong count is reported later."""
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
