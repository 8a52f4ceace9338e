"""Warns of settings that are allowed but probably not intended."""

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

SURFACE_VESSEL = 1.5
"""Ratio of buoyancy, fully submerged, to weight from which a vehicle counts as a surface vessel."""
_SOURCES: Mapping[str, frozenset[str]] = {
    "attitude": frozenset({"Attitude", "Imu", "Pose"}),
    "heading": frozenset({"Attitude", "Pose"}),
    "depth": frozenset({"FluidPressure", "Pose"}),
    "velocity": frozenset({"Dvl", "NavSatFix", "BeaconFix", "BeaconRange", "Pose"}),
    "position": frozenset({"Dvl", "NavSatFix", "BeaconFix", "BeaconRange", "Pose"}),
    "altitude": frozenset({"Range", "Dvl"}),
}
"""Messages of sensors that can give the autopilot what a mode needs."""


class _Body(NamedTuple):
    """One body at the start.

    Attributes:
        path: path of its table.
        position: in N, m.
        radius: radius of a ball of the same volume, m.
        belongs_above: whether a start above the water is plausible: for a surface vessel, or an object that is dropped.
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
    """Warn of everything in a scenario that is probably not intended.

    Args:
        scenario: typed.
        vehicles: by table; several if the table has copies.
        objects: by name.
        warn: called for warnings.
    """
    bodies = list(_bodies(scenario, vehicles, objects))
    _check_above(bodies, warn)
    _check_apart(bodies, warn)
    for key, group in vehicles.items():
        _check_sensors(key, next(iter(group)), warn)  # vehicles of one table have the same sensors


def check_reachable(scenario: Scenario, warn: Report) -> None:
    """Warn of an empty table of adapters."""
    if not scenario.adapters:
        warn(
            ("adapters",),
            "there is no adapter, so nobody can reach the simulation: remove this table for TCP port 7600, or add an adapter",
        )


def _bodies(
    scenario: Scenario, vehicles: Mapping[str, Iterable[ResolvedVehicle]], objects: Mapping[str, ResolvedObject]
) -> Iterator[_Body]:
    """Yield the vehicles and objects that are there at the start; external vehicles are left out, as their poses come from outside."""
    for key, group in vehicles.items():
        for vehicle in group:
            displaced = vehicle.vehicle.buoyancy.volume_m3
            if vehicle.entry.present and displaced > 0.0 and not vehicle.entry.is_external:
                mass = vehicle.vehicle.rigid_body.mass_kg
                floats = scenario.environment.density * displaced > SURFACE_VESSEL * mass
                yield _Body(("vehicles", key), vehicle.name, vehicle.entry.position_ned_m, _radius(displaced), floats)
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
            warn(
                (*body.path, "position_ned_m", 2),
                f"it starts {-z:g} m above the water and will fall; z points down: did you mean {-z:+g}?",
            )


def _check_apart(bodies: Iterable[_Body], warn: Report) -> None:
    """Warn of bodies whose centre lies within another body, once for each pair of tables.

    Bodies are sorted by x, so that a thousand vehicles do not need a million comparisons.
    """
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
                    warn(
                        (*late.path, "position_ned_m"),
                        f"{late.name} and {early.name} start at the same place and push each other apart: move one of them",
                    )


def _check_sensors(key: str, vehicle: ResolvedVehicle, warn: Report) -> None:
    sensors = vehicle.vehicle.sensors
    if not sensors and isinstance(vehicle.entry.truth, UnsetType) and not vehicle.entry.is_external:
        warn(
            ("vehicles", key, "sensors"),
            "it has no sensor, so clients can read nothing from it: add one (`uwserver list sensors` shows all kinds), or a table `truth`",
        )
    autopilot = vehicle.entry.autopilot
    if isinstance(autopilot, UnsetType):
        return
    messages = {sensor.message for sensor in sensors.values()}
    for need in NEEDS[autopilot.mode]:
        if not _SOURCES[need] & messages:
            warn(("vehicles", key, "autopilot", "mode"), f'the mode "{autopilot.mode}" cannot work: {REMEDY[need]}')
            return
