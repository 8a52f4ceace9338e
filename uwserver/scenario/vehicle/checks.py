"""Checks one vehicle across its tables: rigid body and hydrodynamics, appendages, actuators, names, and its built-in autopilot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.actuators import ActuatorConfig
from uwserver.autopilot.config import AutopilotConfig, Gains
from uwserver.physics.dynamics.appendage_params import quadrant_coefficients
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.files.convert import Node, Report, check_known, check_members, convert, fields, is_one_of
from uwserver.scenario.files.errors import KeyPath, suggestion
from uwserver.scenario.vehicle.appendage_tables import Foil, Hull, ShaftPropeller
from uwserver.scenario.vehicle.appendages import TERM, quadrant_series
from uwserver.scenario.vehicle.body import buoyancy_and_weight, matrices
from uwserver.scenario.vehicle.component_checks import check_sensor, enabled
from uwserver.scenario.vehicle.tables import AddedMass, Buoyancy, Damping, RigidBody, VehicleFile
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.tables import Environment, WorldTable
from uwserver.table import Vector3
from uwserver.units import deg

_ROUNDING = 1e-9
_TRIM = 0.05
"""Difference of buoyancy and weight, over the weight, from which there is a warning."""
_SURFACE = 2.0
"""A vehicle whose shapes displace more than this many times its weight is meant to float: it gets no such warning."""
_DERIVATIVE = "an axis of XYZKMN and two velocities of uvwpqr"


def check_vehicle(
    vehicle: Node, world: WorldTable | None, environment: Environment | None, report: Report, warn: Report
) -> None:
    """Check everything that could be read of a vehicle.

    Args:
        vehicle: the merged vehicle file, as a `VehicleFile`.
        world, environment: those of the scenario; None where they have errors.
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
        check_known(lamp.mount, vehicle.names("mounts"), "mount", ("lamps", name, "mount"), report)
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


# -- appendages -------------------------------------------------------------------------------------------------------------------------


def check_appendages(vehicle: Node, report: Report) -> None:
    """Check all appendages of a vehicle file that could be read; `report` is called for errors."""
    for name, foil in vehicle.values("foils").items():
        _check_foil(foil, ("foils", name), report)
    for name, fin in vehicle.values("fins").items():
        _check_foil(fin, ("fins", name), report)
        _check_terms(fin.derivatives, True, ("fins", name, "derivatives"), report)
    hull: Hull | None = vehicle.at("hull").value
    if hull is not None and not isinstance(hull.derivatives, UnsetType):
        _check_terms(hull.derivatives.terms, False, ("hull", "derivatives", "terms"), report)
    for name, propeller in vehicle.values("propellers").items():
        _check_propeller(propeller, ("propellers", name), report)
    for name, ballast in vehicle.values("ballasts").items():
        if not ballast.min_volume_m3 <= ballast.neutral_volume_m3 <= ballast.max_volume_m3:
            report(
                ("ballasts", name, "neutral_volume_m3"),
                f"must lie between min_volume_m3 ({ballast.min_volume_m3:g}) and max_volume_m3 ({ballast.max_volume_m3:g})",
            )
    body: RigidBody | None = vehicle.at("rigid_body").value
    for name, mass in vehicle.values("moving_masses").items():
        path: KeyPath = ("moving_masses", name)
        check_direction(mass.axis_frd, "axis", "a positive position", (*path, "axis_frd"), report)
        if not mass.min_position_m <= 0.0 <= mass.max_position_m:
            report(path, "position 0 must lie between min_position_m and max_position_m")
        if body is not None and mass.mass_kg >= body.mass_kg:
            report((*path, "mass_kg"), f"is part of the vehicle's mass_kg ({body.mass_kg:g}): must be less")


def check_direction(vector: Vector3, noun: str, meaning: str, path: KeyPath, report: Report) -> bool:
    """Return whether a vector is not zero; report it otherwise. `meaning` says what its direction stands for."""
    if not any(vector):
        report(path, f"the {noun} has no direction: give the direction of {meaning}")
    return any(vector)


def _check_propeller(propeller: ShaftPropeller, path: KeyPath, report: Report) -> None:
    check_direction(propeller.axis_frd, "axis", "the thrust at a positive speed", (*path, "axis_frd"), report)
    curve = () if isinstance(propeller.curve, UnsetType) else propeller.curve
    twice = propeller.quadrants is not UNSET and propeller.pitch_ratio is not UNSET
    first_only = "describes four quadrants, but the curve describes the first one only: leave one of the two out"
    faults = (
        ("astern_factor", not curve and propeller.astern_factor != 1.0,
         "works with a curve only: a propeller in four quadrants has its own thrust astern"),
        ("inflow", not curve and propeller.inflow != "axial",
         '"speed" works with a curve only: in four quadrants the direction of the inflow counts'),
        ("pitch_ratio", not curve and twice, "is for the B4-70, but quadrants describe another propeller: leave one of the two out"),
        ("curve", any(b[0] <= a[0] for a, b in pairwise(curve)), "the advance numbers J (first of each point) must rise from point to point"),
        ("pitch_ratio", curve and propeller.pitch_ratio is not UNSET, first_only),
        ("quadrants", curve and propeller.quadrants is not UNSET, first_only),
        ("damping_includes_stopped", curve and propeller.damping_includes_stopped,
         "a stopped propeller with a curve has no drag: leave this key out"),
    )  # fmt: skip
    for key, is_wrong, text in faults:
        if is_wrong:
            report((*path, key), text)
    if not curve:
        _check_quadrants(propeller, path, report)


def _check_quadrants(propeller: ShaftPropeller, path: KeyPath, report: Report) -> None:
    """Check that the propeller nowhere gives more power than its shaft takes: Q 2 pi n - T V_a >= 0."""
    beta = np.linspace(-math.pi, math.pi, 361)
    thrust, torque = quadrant_coefficients(quadrant_series(propeller), beta)
    lost = np.cos(beta) / 0.35 * torque - np.sin(beta) * thrust
    worst = int(lost.argmin())
    if lost[worst] < -1e-3:
        report((*path, "quadrants"), f"the propeller gives more power than its shaft takes at beta = {deg(beta[worst]):.0f} degrees")  # fmt: skip


def _check_foil(foil: Foil, path: KeyPath, report: Report) -> None:
    hinge = check_direction(foil.hinge_frd, "hinge", "the axis of a positive angle", (*path, "hinge_frd"), report)
    if hinge and check_direction(foil.chord_frd, "chord", "the leading edge", (*path, "chord_frd"), report):
        lengths = math.hypot(*foil.hinge_frd) * math.hypot(*foil.chord_frd)
        if float(np.linalg.norm(np.cross(foil.hinge_frd, foil.chord_frd))) < 1e-6 * lengths:
            report((*path, "chord_frd"), "the chord is parallel to the hinge: it must lie across")
    if foil.area_m2 > 0.0 and foil.lift_slope_prad is UNSET and foil.aspect_ratio is UNSET:
        report(path, "a foil with an area needs lift_slope_prad, aspect_ratio, or both: none is given")


def _check_terms(terms: Mapping[str, float], turned: bool, path: KeyPath, report: Report) -> None:
    for term in terms:
        match = TERM.fullmatch(term)
        if match is None or bool(match[4]) != turned:
            example = ", then d or dd for the angle, such as Yuud" if turned else ", such as Yur"
            report((*path, term), f'"{term}" is not a derivative: write {_DERIVATIVE}{example}')


# -- autopilot --------------------------------------------------------------------------------------------------------------------------


def check_autopilot(
    config: AutopilotConfig, vehicle: Node, path: KeyPath, world: WorldTable | None, report: Report
) -> None:
    """Check the rates, the names and values of gains, and that the autopilot can steer the vehicle.

    Args:
        config: the table in the scenario.
        vehicle: the merged vehicle file, as a `VehicleFile`.
        path: path of the table.
        world: world of the scenario; None if it has errors.
        report: called for errors.
    """
    for key in ("rate_hz", "state_rate_hz"):
        rate = getattr(config, key)
        if world is not None and not isinstance(rate, UnsetType):
            check_rate(rate, world.rate_hz, (*path, key), report)
    types: dict[str, Any] = {info.name: info.type for info in fields(Gains)}
    for name, value in config.gains.items():
        place: KeyPath = (*path, "gains", name)
        if name not in types:
            report(place, f'unknown gain "{name}"{suggestion(name, tuple(types))}')
        else:
            convert(value, types[name], place, report)
    for table in ("sensors", "actuators"):
        if "autopilot" in vehicle.values(table):
            report(path, f'"autopilot" in {table} would have the same path as the built-in autopilot: rename it')
    if not is_steerable(vehicle.values("actuators")):
        report(
            path,
            "it cannot steer this vehicle: it needs actuators for thrusters, a force_torque, or fins and a propeller",
        )


def is_steerable(actuators: Mapping[str, ActuatorConfig]) -> bool:
    """Return whether the autopilot can control a vehicle with these: thrusters or a wrench, or fins and a propeller."""
    enabled = [config for config in actuators.values() if config.enabled]
    tables = commanded_tables(enabled)
    has_wrench = any(config.message == "Wrench" for config in enabled)
    return has_wrench or "thrusters" in tables or {"fins", "propellers"} <= tables


def commanded_tables(actuators: Iterable[ActuatorConfig]) -> set[str]:
    """Return those tables of a vehicle file whose entries these actuators command."""
    return {devices.table for config in actuators if (devices := config.devices()) is not None}
