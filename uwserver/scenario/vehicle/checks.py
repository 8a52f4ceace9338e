"""Checks of one vehicle across its tables: rigid body and hydrodynamics, actuators and names."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.files.convert import Node, Report, check_known, check_members, is_one_of
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.vehicle.appendage_checks import check_appendages, check_direction
from uwserver.scenario.vehicle.body import buoyancy_and_weight, matrices
from uwserver.scenario.vehicle.sensor_checks import check_mount, check_sensor, enabled
from uwserver.scenario.vehicle.tables import AddedMass, Buoyancy, Damping, RigidBody, VehicleFile
from uwserver.scenario.water.tables import Environment
from uwserver.scenario.world.tables import WorldTable

_ROUNDING = 1e-9
_TRIM = 0.05
"""Difference of buoyancy and weight, over the weight, from which there is a warning."""
_SURFACE = 2.0
"""A vehicle whose shapes displace more than this many times its weight is meant to float: it gets no such warning."""


def check_vehicle(
    vehicle: Node, world: WorldTable | None, environment: Environment | None, report: Report, warn: Report
) -> None:
    """Check everything that could be read of a vehicle.

    Args:
        vehicle: the merged vehicle file, as a `VehicleFile`.
        world, environment: of the scenario; None where they have errors.
        report, warn: called for errors and warnings.
    """
    if _check_forms(vehicle, report):
        _check_matrices(vehicle, environment, report, warn)
    for name, thruster in vehicle.values("thrusters").items():
        check_direction(
            thruster.axis_frd, "axis", "the force at a positive command", ("thrusters", name, "axis_frd"), report
        )
    _check_devices(vehicle, report)
    check_appendages(vehicle, report)
    _check_names(vehicle, report)
    for name, lamp in vehicle.values("lamps").items():
        check_mount(vehicle, lamp.mount, ("lamps", name, "mount"), report)
    for name, sensor in vehicle.values("sensors").items():
        if sensor.enabled:
            check_sensor(vehicle, name, sensor, world, report)


def _check_forms(vehicle: Node, report: Report) -> bool:
    """Return whether each matrix is given in exactly one form."""
    dampings = [("damping", name) for name in ("linear", "at_rest", "quadratic", "speed")]
    forms: dict[tuple[str, ...], tuple[str, str]] = {("rigid_body",): ("inertia_kgm2", "inertia_matrix_kgm2")}
    forms |= dict.fromkeys([("added_mass",), *dampings], ("diagonal", "matrix"))
    given = [(path, keys, table) for path, keys in forms.items() if (table := vehicle.at(*path).value) is not None]
    fine = [is_one_of(table, keys, path, report) for path, keys, table in given]
    return all(fine)


def _check_matrices(vehicle: Node, environment: Environment | None, report: Report, warn: Report) -> None:
    rigid_body: RigidBody | None = vehicle.at("rigid_body").value
    buoyancy: Buoyancy | None = vehicle.at("buoyancy").value
    added_mass: AddedMass | None = vehicle.at("added_mass").value
    if rigid_body is None or buoyancy is None or added_mass is None:
        return
    body = VehicleFile(
        schema=1, name="", description="", rigid_body=rigid_body, buoyancy=buoyancy, added_mass=added_mass, damping=Damping()
    )  # fmt: skip
    M_RB, M_A = matrices(body)[:2]
    worst = _asymmetry(M_RB)
    if worst is not None:
        report(("rigid_body", "inertia_matrix_kgm2"), f"the inertia is not symmetric: {worst}")
    elif (least := _least_eigenvalue(M_RB)) <= 0.0:
        report(
            ("rigid_body",),
            f"M_RB is not positive definite (smallest eigenvalue {least:.3g}): check mass, inertia and inertia_about",
        )
    worst = _asymmetry(M_A)
    if worst is not None and added_mass.symmetrise:
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


def _check_trim(body: VehicleFile, environment: Environment, warn: Report) -> None:
    buoyancy, weight = buoyancy_and_weight(body, environment)
    excess = buoyancy - weight
    is_surface_vessel = body.buoyancy.shapes and buoyancy > _SURFACE * weight
    if abs(excess) > _TRIM * weight and not is_surface_vessel:
        what = "floats up" if excess > 0.0 else "sinks"
        warn(
            ("buoyancy",),
            f"the vehicle {what} with {abs(excess):.4g} N (buoyancy {buoyancy:.4g} N, weight {weight:.4g} N)",
        )


def _asymmetry(M: FloatArray) -> str | None:
    """Describe the largest asymmetry, rows and columns counted from 1; None if the matrix is symmetric within rounding."""
    difference = np.abs(M - M.T)
    i, j = np.unravel_index(int(difference.argmax()), M.shape)
    if difference[i, j] <= _ROUNDING * np.abs(M).max():
        return None
    return f"({i + 1},{j + 1}) is {M[i, j]:g} but ({j + 1},{i + 1}) is {M[j, i]:g}"


def _least_eigenvalue(M: FloatArray) -> float:
    return float(np.linalg.eigvalsh(0.5 * (M + M.T))[0])


def _check_devices(vehicle: Node, report: Report) -> None:
    """Check that each enabled actuator commands something that the vehicle has."""
    for name, actuator in vehicle.values("actuators").items():
        path: KeyPath = ("actuators", name)
        devices = actuator.devices() if actuator.enabled else None
        if devices is None:
            continue
        table, members, present = devices.table, devices.members, vehicle.names(devices.table)
        if devices.is_vector:
            check_members(members, present, devices.noun, (*path, "members"), report)
            if not members and not present:
                report(path, f"the vehicle has no {table} to command: add some under [{table}]")
            continue
        for member in members:
            check_known(member, present, devices.noun, (*path, devices.key), report)
            if table == "mounts" and "tilt_deg" not in vehicle.at(table, member).parts:
                report((*path, devices.key), f'the mount "{member}" does not tilt: give it tilt_deg')


def _check_names(vehicle: Node, report: Report) -> None:
    sensors, actuators = enabled(vehicle, "sensors"), enabled(vehicle, "actuators")
    for name in actuators:
        if name in sensors:
            report(("actuators", name), f'a sensor is named "{name}" too, so both would have the same path: rename one')
    for table, names in (("sensors", sensors), ("actuators", actuators)):
        for name in {"truth", "world"}.intersection(names):
            report((table, name), f'the server itself uses paths with "{name}": choose another name')
