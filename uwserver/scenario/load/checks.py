"""Checks a scenario across its tables: time, place, names, water, ports and faults, and limits on the numbers of things.

There are limits because a small file can ask for more than can be built.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uwserver.modifiers import Delay
from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.files.documents import Document, named
from uwserver.scenario.files.errors import KeyPath, ScenarioError, not_built
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.body import matrices
from uwserver.scenario.vehicle.component_checks import traits_of
from uwserver.scenario.vehicle.entry import starts
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.scenario.world.checks import check_density, check_earth, check_environment, check_rate, check_time
from uwserver.scenario.world.tables import Environment
from uwserver.sensors import SensorConfig
from uwserver.sensors.truth import TRUTH
from uwserver.world.faults import FaultConfig, Hull, Targets, effects, refusals
from uwserver.world.faults.timeline import MAX_FAULTS

MOST_BODIES = 2000
"""Most vehicles, copies included, and objects together; those that are not present at the start count too."""
MOST_STRUCTURES = 2000
MOST_WAITING = 512 << 20
"""Most bytes of readings, of all sensors, that are measured but not delivered yet."""
_READING, _SIGMAS = 2048, 6.0
"""Bytes of a reading without its pictures (1 to 2 kB were measured), and standard deviations of jitter that are counted."""
MOST_COMPONENTS = 100_000
"""Most sensors, further streams, modifiers and actuators of all vehicles together."""


def check_scenario(tree: Node, report: Report, warn: Report) -> None:
    """Check time, place, names, water and ports.

    Args:
        tree: the scenario file; only what has no errors yet is checked.
        report, warn: called for errors and warnings.
    """
    world, vehicles = tree.at("world").value, tree.at("vehicles").parts
    if world is not None:
        check_time(world, report)
        check_earth(world, report)
        for name, entry in vehicles.items():
            truth = entry.at("truth").value
            if truth is not None:
                check_rate(truth.rate_hz, world.rate_hz, ("vehicles", name, "truth", "rate_hz"), report)
    if "world" in vehicles:
        report(
            ("vehicles", "world"),
            'a vehicle cannot be named "world", as paths of services begin with it: choose another name',
        )
    check_environment(tree.at("environment"), report, warn)
    check_density(tree, report, warn)
    if tree.at("start").value == "held":
        _check_held(vehicles, report)
    if tree.value is not None:
        _check_ports(tree.value, warn)


def _check_held(vehicles: Mapping[str, Node], report: Report) -> None:
    """Check that vehicles which are to be held begin at rest."""
    for name, entry in vehicles.items():
        if entry.at("kind").value == "external":
            continue
        for key in ("velocity_frd_mps", "angular_velocity_frd_degps"):
            if any(entry.at(key).value or ()):
                text = f'start = "held" holds it at rest: leave {key} out, or set start = "free"'
                report(("vehicles", name, key), text)


def _check_ports(scenario: Scenario, warn: Report) -> None:
    taken: dict[int, str] = {}
    if scenario.server.metrics:
        taken[scenario.server.metrics_port] = "server.metrics_port"
    for name, config in scenario.adapters.items():
        port = getattr(config, "port", 0)
        if not isinstance(port, int) or port == 0:
            continue
        if port in taken:
            warn(
                ("adapters", name, "port"),
                f"{taken[port]} uses port {port} too: unless one is TCP and the other UDP, only one of them can start",
            )
        taken.setdefault(port, f"adapters.{name}")


# -- faults -----------------------------------------------------------------------------------------------------------------------------


def check_faults(scenario: Node, vehicles: Mapping[str, VehicleFile], environment: Environment, report: Report) -> None:
    """Check targets, members and sizes of all faults, once all vehicles could be read; `vehicles` by table."""
    targets = _targets(scenario, vehicles, environment)
    before: list[FaultConfig] = []
    for name, fault in scenario.values("faults").items():
        path: KeyPath = ("faults", name)
        try:
            parts = effects(name, fault, targets, np.random.default_rng(0))
        except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
            report(path, not_built(fault, error))
            continue
        for part in parts.values():
            for key, text in refusals(part, targets, before):
                if part is fault:
                    report((*path, key), text)
                else:
                    report(path, f'it results in a "{part.__struct_config__.tag}" fault with an error: {key}: {text}')
            before.append(part)
        if len(before) > MAX_FAULTS:
            report(path, f"a world can have at most {MAX_FAULTS} faults, and this is one too many: remove some")
            return


def _targets(scenario: Node, vehicles: Mapping[str, VehicleFile], environment: Environment) -> Targets:
    thrusters: dict[str, tuple[str, ...]] = {}
    sensors: list[str] = []
    hulls: dict[str, Hull] = {}
    water = environment.density * environment.gravity
    for table, name, _ in starts(scenario, "vehicles"):
        vehicle = vehicles[table]
        for key, actuator in vehicle.actuators.items():
            devices = actuator.devices()
            if devices is not None and devices.table == "thrusters":
                thrusters[f"{name}/{key}"] = devices.members or tuple(vehicle.thrusters)
        sensors += [config.port_of(name, key) for key, config in vehicle.sensors.items()]
        if "truth" in scenario.at("vehicles", table).parts:
            sensors += [f"{name}/truth/{key}" for key in TRUTH]
        M_RB, r_g = matrices(vehicle).M_RB, vehicle.rigid_body.center_of_mass_frd_m
        hulls[name] = Hull(M_RB, r_g, vehicle.buoyancy.volume_m3, water)
    return Targets(hulls, thrusters, tuple(sensors))


# -- numbers of things ------------------------------------------------------------------------------------------------------------------


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
