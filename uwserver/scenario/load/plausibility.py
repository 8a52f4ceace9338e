"""What is allowed in a scenario, and hardly meant: told as warnings, so that nobody has to find it out from how the run looks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from msgspec import UnsetType

from uwserver.autopilot.modes import NEEDS, REMEDY
from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.load.resolved import ResolvedObject, ResolvedVehicle
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.objects import volume
from uwserver.table import Vector3

FLOATS = 1.5
"""Buoyancy over weight of a vehicle, fully under water, from which it is a surface vessel."""
_SOURCES: Mapping[str, frozenset[str]] = {
    "attitude": frozenset({"attitude", "imu", "motion_capture"}),
    "heading": frozenset({"attitude", "motion_capture"}),
    "depth": frozenset({"pressure", "motion_capture"}),
    "velocity": frozenset({"dvl", "gps", "usbl", "lbl", "motion_capture"}),
    "position": frozenset({"dvl", "gps", "usbl", "lbl", "motion_capture"}),
    "altitude": frozenset({"altimeter", "dvl"}),
}
"""Kinds of sensor from which the autopilot can have what a mode needs."""


class _Body(NamedTuple):
    """One body at the start.

    Attributes:
        path: of its table.
        position: in N, m.
        radius: of a ball of its volume, m.
        belongs_above: whether it may well begin above the water: a surface vessel, or something that is dropped.
    """

    path: KeyPath
    name: str
    position: Vector3
    radius: float
    belongs_above: bool


def check_plausible(
    scenario: Scenario,
    vehicles: Mapping[str, Iterable[ResolvedVehicle]],
    objects: Mapping[str, ResolvedObject],
    warn: Report,
) -> None:
    """Warn of what was hardly meant.

    Args:
        scenario: typed.
        vehicles: by table; several where it has copies.
        objects: by name.
        warn: takes in the warnings.
    """
    bodies = [*_vehicle_bodies(scenario, vehicles), *_object_bodies(objects)]
    _check_above(bodies, warn)
    _check_apart(bodies, warn)
    for key, group in vehicles.items():
        for vehicle in group:
            _check_sensors(key, vehicle, warn)
            break  # those of one table are alike


def check_reachable(scenario: Scenario, warn: Report) -> None:
    """Warn of a file with an empty table of adapters."""
    if not scenario.adapters:
        text = 'there are none, so nobody can reach the simulation: take this table out for TCP port 7600, or add one with kind = "sockets"'
        warn(("adapters",), text)


def _vehicle_bodies(scenario: Scenario, vehicles: Mapping[str, Iterable[ResolvedVehicle]]) -> Iterator[_Body]:
    density = scenario.environment.density
    for key, group in vehicles.items():
        for vehicle in group:
            displaced = vehicle.vehicle.buoyancy.volume_m3
            if vehicle.entry.present and displaced > 0.0 and not vehicle.entry.is_external:
                floats = density * displaced > FLOATS * vehicle.vehicle.rigid_body.mass_kg
                position = vehicle.entry.position_ned_m
                yield _Body(("vehicles", key), vehicle.name, position, _radius(displaced), floats)


def _object_bodies(objects: Mapping[str, ResolvedObject]) -> Iterator[_Body]:
    for name, body in objects.items():
        if body.entry.present:
            yield _Body(("objects", name), name, body.entry.position_ned_m, _radius(volume(body.entry)), True)


def _radius(displaced: float) -> float:
    return float(np.cbrt(0.75 * displaced / math.pi))


def _check_above(bodies: Iterable[_Body], warn: Report) -> None:
    told: set[KeyPath] = set()
    for body in bodies:
        z = body.position[2]
        if z < -body.radius and not body.belongs_above and body.path not in told:
            told.add(body.path)
            text = f"{-z:g} m above the water, from where it falls; z is down: did you mean {-z:+g}?"
            warn((*body.path, "position_ned_m", 2), text)


def _check_apart(bodies: Iterable[_Body], warn: Report) -> None:
    """No body's centre may lie within another; told once for two tables. Sorted by x, so that a thousand vehicles take no million steps."""
    line = sorted(bodies, key=lambda body: body.position[0])
    told: set[tuple[KeyPath, KeyPath]] = set()
    for k, one in enumerate(line):
        for other in line[k + 1 :]:
            if other.position[0] - one.position[0] > one.radius + other.radius:
                break
            if math.dist(one.position, other.position) < max(one.radius, other.radius):
                late, early = (one, other) if one.path == other.path else sorted((one, other), reverse=True)
                if (late.path, early.path) not in told:
                    told.add((late.path, early.path))
                    text = (
                        f"{late.name} and {early.name} begin in one place, and push each other apart: move one of them"
                    )
                    warn((*late.path, "position_ned_m"), text)


def _check_sensors(key: str, vehicle: ResolvedVehicle, warn: Report) -> None:
    sensors = vehicle.vehicle.sensors
    if not sensors and isinstance(vehicle.entry.truth, UnsetType) and not vehicle.entry.is_external:
        text = "it has no sensor, so nothing can be read of it: `uwserver list sensors` shows what there is"
        warn(("vehicles", key, "sensors"), text)
    autopilot = vehicle.entry.autopilot
    if isinstance(autopilot, UnsetType):
        return
    kinds = {str(sensor.__struct_config__.tag) for sensor in sensors.values()}
    for need in NEEDS[autopilot.mode]:
        if not _SOURCES[need] & kinds:
            warn(("vehicles", key, "autopilot", "mode"), f'"{autopilot.mode}" cannot work: {REMEDY[need]}')
            return
