"""Checks of one vehicle across its tables: rigid body and hydrodynamics, propulsion and names."""

from __future__ import annotations

import numpy as np
from msgspec import UNSET, Struct

from uwserver.actuators import CameraMountConfig, LampsConfig, ThrusterConfig, ThrustersConfig
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.vehicle.appendage_checks import check_appendages, check_member
from uwserver.scenario.vehicle.assembly import Draft
from uwserver.scenario.vehicle.body import buoyancy_and_weight, matrices
from uwserver.scenario.vehicle.sensor_checks import check_mount, check_sensor
from uwserver.scenario.vehicle.tables import Damping, VehicleFile
from uwserver.scenario.water.tables import Environment
from uwserver.scenario.world.tables import WorldTable

_ROUNDING = 1e-9
_TRIM = 0.05
"""Buoyancy this far from the weight (relative) is worth a word."""
_SURFACE = 2.0
"""With shapes that displace more than this many times its weight a vehicle is meant to float, and is told nothing."""


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
            text = "the axis has no direction: give the direction of the force at a positive command"
            report(("thrusters", name, "axis_frd"), text)
    _check_members(draft, report)
    check_appendages(draft, report)
    _check_names(draft, report)
    for name, lamp in draft.lamps.items():
        check_mount(draft, lamp.mount, ("lamps", name, "mount"), report)
    for name, sensor in draft.sensors.items():
        if sensor.enabled:
            check_sensor(draft, name, sensor, world, report)


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
    body = VehicleFile(
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
        text = f"M_A is not symmetric: {worst}; correct it, or take its symmetric part by symmetrise = true"
        report(("added_mass",), text)
    least = _least_eigenvalue(M_A)
    if least < -_ROUNDING * float(np.abs(M_A).max()):
        text = f"M_A is not positive semi-definite (smallest eigenvalue {least:.3g}): check its signs and couplings"
        report(("added_mass",), text)
    if environment is not None:
        _check_trim(body, environment, warn)


def _check_trim(body: VehicleFile, environment: Environment, warn: Report) -> None:
    buoyancy, weight = buoyancy_and_weight(body, environment)
    excess = buoyancy - weight
    if body.buoyancy.shapes and buoyancy > _SURFACE * weight:
        return
    if abs(excess) > _TRIM * weight:
        what = "floats up" if excess > 0.0 else "sinks"
        text = f"the vehicle {what} with {abs(excess):.4g} N (buoyancy {buoyancy:.4g} N, weight {weight:.4g} N)"
        warn(("buoyancy",), text)


def _asymmetry(M: FloatArray) -> str | None:
    """The largest asymmetry in words; None within rounding. Rows and columns count from 1."""
    difference = np.abs(M - M.T)
    i, j = np.unravel_index(int(difference.argmax()), M.shape)
    if difference[i, j] <= _ROUNDING * np.abs(M).max():
        return None
    return f"({i + 1},{j + 1}) is {M[i, j]:g} but ({j + 1},{i + 1}) is {M[j, i]:g}"


def _least_eigenvalue(M: FloatArray) -> float:
    return float(np.linalg.eigvalsh(0.5 * (M + M.T))[0])


def _check_members(draft: Draft, report: Report) -> None:
    present = draft.names("thrusters")
    for name, actuator in draft.actuators.items():
        path: KeyPath = ("actuators", name)
        if not actuator.enabled:
            continue
        if isinstance(actuator, ThrusterConfig):
            check_member(actuator.member, present, "thruster", (*path, "member"), report)
        if isinstance(actuator, LampsConfig):
            for k, member in enumerate(actuator.members):
                check_member(member, draft.names("lamps"), "lamp", (*path, "members", k), report)
            if not draft.lamps:
                report(path, "the vehicle has no lamps to command: give it some under [lamps]")
        if isinstance(actuator, CameraMountConfig):
            check_mount(draft, actuator.mount, (*path, "mount"), report)
            if "tilt_deg" not in draft.tree.at("mounts", actuator.mount).parts:
                report((*path, "mount"), f'the mount "{actuator.mount}" does not tilt: give it tilt_deg')
        if not isinstance(actuator, ThrustersConfig):
            continue
        if actuator.members is None and not present:
            report(path, "the vehicle has no thrusters to command")
        members = actuator.members or ()
        for k, member in enumerate(members):
            check_member(member, present, "thruster", (*path, "members", k), report)
            if member in members[:k]:
                report((*path, "members", k), f'"{member}" is named twice')


def _check_names(draft: Draft, report: Report) -> None:
    sensors, actuators = draft.enabled("sensors"), draft.enabled("actuators")
    for name in actuators:
        if name in sensors:
            report(("actuators", name), f'a sensor has the name "{name}" too: both would have one path; rename one')
    for table, names in (("sensors", sensors), ("actuators", actuators)):
        for name in {"truth", "world"}.intersection(names):
            report((table, name), f'"{name}" is taken by the server\'s own paths: choose another name')
