"""Checks of one vehicle across its tables: rigid body and hydrodynamics, propulsion, sensors and names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import numpy as np
import numpy.typing as npt
from msgspec import UNSET, Struct

from uwserver.actuators import ThrusterConfig, ThrustersConfig
from uwserver.logs import place_of
from uwserver.modifiers import Modifier, ModifierConfig, Stream
from uwserver.ports import Field
from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.documents import label_of
from uwserver.scenario.files.errors import KeyPath, suggestion
from uwserver.scenario.vehicle.appendage_checks import check_appendages
from uwserver.scenario.vehicle.assembly import Draft
from uwserver.scenario.vehicle.body import buoyancy_and_weight, matrices
from uwserver.scenario.vehicle.tables import Damping, Vehicle
from uwserver.scenario.water.tables import Environment
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.epoch import instant, year_of
from uwserver.scenario.world.magnetic import WMM_YEARS
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import CompoundConfig, Pose, RpmConfig, Sensor, SensorConfig
from uwserver.world.services import SENSOR_SERVICES

_ROUNDING = 1e-9
_TRIM = 0.05
"""Buoyancy this far from the weight (relative) is worth a word."""

Matrix = npt.NDArray[np.float64]


def check_vehicle(
    draft: Draft, world: WorldTable | None, environment: Environment | None, report: Report, warn: Report
) -> None:
    """All checks of what could be read.

    Args:
        draft: the merged vehicle.
        world, environment: of the scenario; None where they have faults.
        report, warn: take in faults and warnings.
    """
    if _check_forms(draft, report):
        _check_matrices(draft, environment, report, warn)
    for name, thruster in draft.thrusters.items():
        if not any(thruster.axis_frd):
            report(
                ("thrusters", name, "axis_frd"),
                "the axis has no direction: give the direction of the force at a positive command",
            )
    _check_members(draft, report)
    check_appendages(draft, report)
    _check_names(draft, report)
    for name, sensor in draft.sensors.items():
        if sensor.enabled:
            _check_sensor(draft, name, sensor, world, report)


def one_of(table: Struct, names: tuple[str, ...], path: KeyPath, report: Report) -> bool:
    """Whether exactly one of the keys is given; reports it otherwise."""
    given = [name for name in names if getattr(table, name) is not UNSET]
    if len(given) != 1:
        found = "both are given" if given else "none is given"
        report(path, f"give exactly one of {' and '.join(names)}: {found}")
    return len(given) == 1


def _check_forms(draft: Draft, report: Report) -> bool:
    """Whether each matrix is given in exactly one form."""
    fine = []
    if draft.rigid_body is not None:
        fine.append(one_of(draft.rigid_body, ("inertia_kgm2", "inertia_matrix_kgm2"), ("rigid_body",), report))
    if draft.added_mass is not None:
        fine.append(one_of(draft.added_mass, ("diagonal", "matrix"), ("added_mass",), report))
    for name in ("linear", "at_rest", "quadratic", "speed"):
        table = getattr(draft.damping, name, UNSET)
        if table is not UNSET:
            fine.append(one_of(table, ("diagonal", "matrix"), ("damping", name), report))
    return all(fine)


def _check_matrices(draft: Draft, environment: Environment | None, report: Report, warn: Report) -> None:
    if draft.rigid_body is None or draft.buoyancy is None or draft.added_mass is None:
        return
    body = Vehicle(
        schema=1, name="", description="", rigid_body=draft.rigid_body, buoyancy=draft.buoyancy, added_mass=draft.added_mass,
        damping=Damping(),
    )  # fmt: skip
    M_RB, M_A = matrices(body)[:2]
    worst = _asymmetry(M_RB)
    if worst is not None:
        report(("rigid_body", "inertia_matrix_kgm2"), f"the inertia is not symmetric: {worst}")
    elif (least := _least_eigenvalue(M_RB)) <= 0.0:
        text = f"M_RB is not positive definite (smallest eigenvalue {least:.3g}): check mass, inertia and inertia_about"
        report(("rigid_body",), text)
    worst = _asymmetry(M_A)
    if worst is not None and draft.added_mass.symmetrise:
        warn(("added_mass",), f"M_A is not symmetric, its symmetric part is used: {worst}")
    elif worst is not None:
        report(
            ("added_mass",),
            f"M_A is not symmetric: {worst}; correct it, or take its symmetric part by symmetrise = true",
        )
    least = _least_eigenvalue(M_A)
    if least < -_ROUNDING * float(np.abs(M_A).max()):
        report(
            ("added_mass",),
            f"M_A is not positive semi-definite (smallest eigenvalue {least:.3g}): check its signs and couplings",
        )
    if environment is not None:
        _check_trim(body, environment, warn)


def _check_trim(body: Vehicle, environment: Environment, warn: Report) -> None:
    buoyancy, weight = buoyancy_and_weight(body, environment)
    excess = buoyancy - weight
    if abs(excess) > _TRIM * weight:
        what = "floats up" if excess > 0.0 else "sinks"
        warn(
            ("buoyancy",),
            f"the vehicle {what} with {abs(excess):.4g} N (buoyancy {buoyancy:.4g} N, weight {weight:.4g} N)",
        )


def _asymmetry(M: Matrix) -> str | None:
    """The largest asymmetry in words; None within rounding. Rows and columns count from 1."""
    difference = np.abs(M - M.T)
    i, j = np.unravel_index(int(difference.argmax()), M.shape)
    if difference[i, j] <= _ROUNDING * np.abs(M).max():
        return None
    return f"({i + 1},{j + 1}) is {M[i, j]:g} but ({j + 1},{i + 1}) is {M[j, i]:g}"


def _least_eigenvalue(M: Matrix) -> float:
    return float(np.linalg.eigvalsh(0.5 * (M + M.T))[0])


def _check_members(draft: Draft, report: Report) -> None:
    present = draft.names("thrusters")
    for name, actuator in draft.actuators.items():
        path: KeyPath = ("actuators", name)
        if not actuator.enabled:
            continue
        if isinstance(actuator, ThrusterConfig):
            _check_member(actuator.member, present, (*path, "member"), report)
        if not isinstance(actuator, ThrustersConfig):
            continue
        if actuator.members is None and not present:
            report(path, "the vehicle has no thrusters to command")
        members = actuator.members or ()
        for k, member in enumerate(members):
            _check_member(member, present, (*path, "members", k), report)
            if member in members[:k]:
                report((*path, "members", k), f'"{member}" is named twice')


def _check_member(member: str, present: tuple[str, ...], path: KeyPath, report: Report) -> None:
    if member not in present:
        report(path, f'no thruster "{member}"{suggestion(member, present, "; there are: ")}')


def _check_names(draft: Draft, report: Report) -> None:
    sensors, actuators = list(_enabled(draft, "sensors")), list(_enabled(draft, "actuators"))
    for name in actuators:
        if name in sensors:
            report(("actuators", name), f'a sensor has the name "{name}" too: both would have one path; rename one')
    for table, names in (("sensors", sensors), ("actuators", actuators)):
        for name in {"truth", "world"}.intersection(names):
            report((table, name), f'"{name}" is taken by the server\'s own paths: choose another name')


def _enabled(draft: Draft, table: str) -> Iterator[str]:
    for name, component in draft.tree.at(table).parts.items():
        if component.at("enabled").value is not False:
            yield name


def _check_sensor(draft: Draft, name: str, sensor: SensorConfig, world: WorldTable | None, report: Report) -> None:
    path: KeyPath = ("sensors", name)
    if world is not None:
        check_rate(sensor.rate_hz, world.rate_hz, (*path, "rate_hz"), report)
        if getattr(sensor, "needs_origin", False):
            _check_origin(world, path, report)
    _check_parts(draft, sensor, path, report)
    if isinstance(sensor.mount, str):
        mounts = draft.names("mounts")
        if sensor.mount not in mounts:
            text = f'no mount "{sensor.mount}"{suggestion(sensor.mount, mounts, "; there are: ")}'
            report((*path, "mount"), text)
        for key in ("position_frd_m", "rpy_deg"):
            if key in draft.tree.at("sensors", name).parts:
                report(
                    (*path, key),
                    f'a sensor on the mount "{sensor.mount}" has no {key} of its own: remove one of the two',
                )
    modifiers: dict[KeyPath, ModifierConfig] = {(*path, "modifiers", key): m for key, m in sensor.modifiers.items()}
    for stream_name, stream in sensor.streams.items():
        place: KeyPath = (*path, "streams", stream_name)
        if stream_name in SENSOR_SERVICES:
            report(place, f'"{stream_name}" is the name of a service of the sensor: choose another name')
        modifiers |= {(*place, "modifiers", key): m for key, m in stream.modifiers.items()}
    # A shipped kind can always be built, and is where the world is: only what its errors need to know of it is asked for now.
    if not modifiers and type(sensor) in get_args(SensorConfig):
        return
    ports = _fields(sensor, path, report)
    if ports is not None:
        for place, modifier in modifiers.items():
            _check_modifier(sensor, ports, modifier, place, report)


def _check_origin(world: WorldTable, path: KeyPath, report: Report) -> None:
    if world.origin_lat_deg is UNSET or world.origin_lon_deg is UNSET:
        report(path, "needs to know where N lies: give [world] origin_lat_deg and origin_lon_deg")
    try:
        year = year_of(instant(world.epoch_utc))
    except ValueError:
        return  # told elsewhere
    first, last = WMM_YEARS
    if not first <= year < last:
        text = f"the magnetic model holds from {first} to {last - 1}, [world] epoch_utc is in {int(year)}"
        report(path, text)


def _check_parts(draft: Draft, sensor: SensorConfig, path: KeyPath, report: Report) -> None:
    if isinstance(sensor, RpmConfig):
        for k, member in enumerate(sensor.members):
            _check_member(member, draft.names("thrusters"), (*path, "members", k), report)
    if not isinstance(sensor, CompoundConfig):
        return
    present = [name for name in _enabled(draft, "sensors") if name != path[-1]]
    for k, member in enumerate(sensor.members):
        place: KeyPath = (*path, "members", k)
        if member not in present:
            report(place, f'no sensor "{member}"{suggestion(member, present, "; there are: ")}')
        elif isinstance(draft.sensors.get(member), CompoundConfig):
            report(place, f'"{member}" is a compound sensor itself')
        if member in sensor.members[:k]:
            report(place, f'"{member}" is named twice')


def _fields(sensor: SensorConfig, path: KeyPath, report: Report) -> tuple[Field, ...] | None:
    """Of the sensor's port; None after a report, which only a kind of an extension needs."""
    try:
        built: object = sensor.build(Pose())
        if not isinstance(built, Sensor):
            raise TypeError("it must derive from uwserver.sensors.Sensor or IdealSensor")
        _check_fields(built.fields)
    except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
        report(path, _failed(sensor, error))
        return None
    return built.fields


def _check_fields(fields: object) -> None:
    """ValueError unless these can be the fields of a port."""
    if not isinstance(fields, tuple) or not fields or not all(isinstance(field, Field) for field in fields):
        raise ValueError("its fields must be a tuple of uwserver.ports.Field")
    if len({field.name for field in fields}) < len(fields):
        raise ValueError("two of its fields have one name")


def _check_modifier(
    sensor: SensorConfig, fields: tuple[Field, ...], modifier: ModifierConfig, path: KeyPath, report: Report
) -> None:
    stream = Stream(fields, 1.0 / sensor.rate_hz, np.random.default_rng(0))
    target = getattr(modifier, "field", None)
    try:
        if isinstance(target, str):
            stream.index(target)
    except ValueError as error:
        report((*path, "field"), str(error))
        return
    try:
        if not isinstance(modifier.build(stream), Modifier):
            raise TypeError("it must derive from uwserver.modifiers.Modifier")
    except ValueError as error:
        report(path, str(error))
    except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
        report(path, _failed(modifier, error))


def _failed(table: Struct, error: Exception) -> str:
    file, line = place_of(error)
    kind = table.__struct_config__.tag
    return (
        f'a component of kind "{kind}" cannot be built ({label_of(Path(file))}:{line}): {type(error).__name__}: {error}'
    )
