"""Converts a vehicle file to kernel parameters: matrices about the body origin, in the water of the scenario."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import UNSET, UnsetType, msgpack, structs

from uwserver.actuators import ActuatorConfig, Body
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import (
    BodyParams,
    BuoyancyShape,
    ForceTable,
    Lag,
    NearBoundary,
    ThrusterParams,
    rigid_body_inertia,
)
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NEAR_CYLINDER, NEAR_SPHERE, SHAPE_BOX, SHAPE_SPHERE, TABLE_SIZE
from uwserver.scenario.vehicle.appendages import appendages
from uwserver.scenario.vehicle.tables import (
    BoxShape,
    Coefficients,
    ForceCurve,
    LagTable,
    RigidBody,
    SphereShape,
    Thruster,
    ThrusterDevice,
    VehicleFile,
)
from uwserver.scenario.world.tables import Environment
from uwserver.units import rad

_NEAR_FORMS = {"cylinder": NEAR_CYLINDER, "sphere": NEAR_SPHERE}


class Matrices(NamedTuple):
    """Mass and damping matrices, (6, 6) each, about the body origin, at the reference densities of the file."""

    M_RB: FloatArray
    M_A: FloatArray
    D_L: FloatArray
    D_Q: FloatArray
    D_S: FloatArray


def matrices(vehicle: VehicleFile) -> Matrices:
    """Return the matrices as the file has them; M_A may be asymmetric."""
    damping = vehicle.damping
    return Matrices(
        _rigid_body(vehicle.rigid_body),
        _matrix(vehicle.added_mass),
        _matrix(damping.linear) + _matrix(damping.at_rest),
        _matrix(damping.quadratic),
        _matrix(damping.speed),
    )


def buoyancy_and_weight(vehicle: VehicleFile, environment: Environment) -> tuple[float, float]:
    """Return the buoyancy when fully submerged, and the weight, N."""
    g = environment.gravity
    return environment.density * g * vehicle.buoyancy.volume_m3, g * vehicle.rigid_body.mass_kg


def body_params(vehicle: VehicleFile, devices: Mapping[str, ThrusterDevice], environment: Environment) -> BodyParams:
    """Return the kernel parameters of a checked vehicle. M_A and damping are scaled to the density of the water, and M_A is made symmetric."""
    M = matrices(vehicle)
    M_A = 0.5 * (M.M_A + M.M_A.T) * (environment.density / vehicle.added_mass.reference_density_kgpm3)
    scale = environment.density / vehicle.damping.reference_density_kgpm3
    buoyancy, weight = buoyancy_and_weight(vehicle, environment)
    near = vehicle.added_mass.near_boundary
    return BodyParams(
        M_RB=M.M_RB,
        M_A=M_A,
        D_L=M.D_L * scale,
        D_Q=M.D_Q * scale,
        D_S=M.D_S * scale,
        weight=weight,
        buoyancy=buoyancy,
        r_g=vehicle.rigid_body.center_of_mass_frd_m,
        r_b=vehicle.buoyancy.center_frd_m,
        shapes=tuple(map(_shape, vehicle.buoyancy.shapes.values())),
        displaced=environment.density * vehicle.buoyancy.volume_m3,
        gravity_growth=environment.growth,
        thrusters=tuple(
            thruster_params(name, thruster, devices[name], environment.density)
            for name, thruster in vehicle.thrusters.items()
        ),
        appendages=appendages(vehicle, environment),
        wrenches=1 + len(own_actuators(vehicle)),
        length=None if isinstance(vehicle.buoyancy.length_m, UnsetType) else vehicle.buoyancy.length_m,
        near=NearBoundary() if isinstance(near, UnsetType) else NearBoundary(_NEAR_FORMS[near.form], near.radius_m),
    )


Made = tuple[VehicleFile, Mapping[str, ThrusterDevice]]
"""A checked vehicle, and the device of each of its thrusters."""


def params_by_name(vehicles: Mapping[str, Made], environment: Environment) -> dict[str, BodyParams]:
    """Return `body_params` of several vehicles by name. Vehicles that differ only in sensors share one object, so a world makes their rows once."""
    known: dict[int, BodyParams] = {}
    alike: dict[bytes, BodyParams] = {}
    for vehicle, devices in vehicles.values():
        if id(vehicle) not in known:
            body = structs.replace(vehicle, sensors={}, autopilot=UNSET)
            key = msgpack.encode((body, dict(devices)))
            if key not in alike:
                alike[key] = body_params(vehicle, devices, environment)
            known[id(vehicle)] = alike[key]
    return {name: known[id(vehicle)] for name, (vehicle, _) in vehicles.items()}


def own_actuators(vehicle: VehicleFile) -> dict[str, ActuatorConfig]:
    """Return those actuators of a vehicle, by name, whose kind has a wrench of its own, as kinds of extensions have."""
    return {name: config for name, config in vehicle.actuators.items() if config.own_wrench}


def own_rows(hydro: Hydrodynamics, vehicle: VehicleFile, row: int) -> dict[str, Body]:
    """Return the rows of a vehicle that its actuators may write: one `Body` with the vehicle's wrench under "", and for each actuator of a kind
    with a wrench of its own one under its name.

    Args:
        hydro: arrays of the world.
        vehicle: a checked vehicle.
        row: row of its body, which has been added already.
    """
    first, wrench, first_servo = (int(hydro.bodies[f"{kind}_first"][row]) for kind in ("thruster", "wrench", "servo"))
    thrusters = {thruster: first + k for k, thruster in enumerate(vehicle.thrusters)}
    servos = {servo.name: first_servo + k for k, servo in enumerate(hydro.params[row].appendages.servos)}
    names, lamps = ("", *own_actuators(vehicle)), tuple(vehicle.lamps)
    tilts = {
        mount: (rad(table.tilt_deg[0]), rad(table.tilt_deg[1]), rad(table.tilt_rate_degps))
        for mount, table in vehicle.mounts.items()
        if not isinstance(table.tilt_deg, UnsetType)
    }
    return {name: Body(hydro, row, thrusters, wrench + k, servos, lamps, tilts) for k, name in enumerate(names)}


def thruster_params(name: str, thruster: Thruster, device: ThrusterDevice, density: float) -> ThrusterParams:
    """Return the parameters of one thruster from its place on the vehicle and its device, in water of a density (kg/m3)."""
    sense = {"right": -1.0, "left": 1.0, "none": 0.0}[thruster.handedness]
    propeller = device.propeller
    stopped = 0.0 if thruster.damping_includes_stopped else propeller.stopped_drag
    return ThrusterParams(
        name=name,
        r=thruster.position_frd_m,
        axis=thruster.axis_frd,
        table=force_table(device),
        voltage=device.default_voltage_V if isinstance(thruster.voltage_V, UnsetType) else thruster.voltage_V,
        lag=lag(device.lag),
        torque_per_force=sense * propeller.torque_per_force_m,
        inflow=thruster.inflow_factor * propeller.inflow_sqrtN_spm,
        drag=0.125 * math.pi * density * propeller.diameter_m**2 * stopped,
        disc_radius=0.5 * propeller.diameter_m,
        installed=thruster.installed_factor,
        cross_loss=thruster.cross_flow_loss_s2pm2,
        ventilates=thruster.ventilates,
    )


def force_table(device: ThrusterDevice) -> ForceTable:
    """Return static force against command of a checked device: a curve for each voltage, in rising order of voltage."""
    curves = {
        table.voltage_V: tuple(zip(table.commands, table.forces_N, strict=True)) for table in device.tables.values()
    }
    if not isinstance(device.shape, UnsetType):
        coefficients = device.shape.coefficients
        curves |= {curve.voltage_V: _curve(curve, coefficients) for curve in device.curves.values()}
    voltages = sorted(curves)
    return _shared(ForceTable(tuple(voltages), tuple(curves[voltage] for voltage in voltages)))


@lru_cache(maxsize=64)
def _shared(table: ForceTable) -> ForceTable:
    """Return one object for all equal tables: a table takes 140 kB per vehicle, and there may be a hundred vehicles."""
    return table


def _curve(curve: ForceCurve, coefficients: tuple[float, ...]) -> tuple[tuple[float, float], ...]:
    """Return points of the curve: the device's shape from each limit to the dead band, and zero within it."""
    low, high = curve.dead_band
    n = (TABLE_SIZE - 2) // 2
    full, forward, reverse = _odd(coefficients, 1.0), curve.max_forward_N, curve.max_reverse_N
    astern = [(-1.0 + k / n * (1.0 + low), -reverse * _odd(coefficients, 1.0 - k / n) / full) for k in range(n)]
    ahead = [(high + k / n * (1.0 - high), forward * _odd(coefficients, k / n) / full) for k in range(1, n + 1)]
    return (*astern, (low, 0.0), (high, 0.0), *ahead)


def _odd(coefficients: tuple[float, ...], v: float) -> float:
    return float(sum(c * v ** (2 * k + 1) for k, c in enumerate(coefficients)))


def lag(table: LagTable) -> Lag:
    """Return the lag of a checked table; a numerator of lower order is padded with zeros.

    Raises:
        ValueError: the denominator is not of third order.
    """
    if not isinstance(table.time_constant_s, UnsetType):
        return Lag.first_order(table.time_constant_s)
    if isinstance(table.numerator, UnsetType) or isinstance(table.denominator, UnsetType):
        return Lag()
    if len(table.denominator) != 4 or len(table.numerator) > 3 or table.denominator[0] == 0.0:
        raise ValueError("a transfer function needs 4 denominator and at most 3 numerator coefficients")
    lead = table.denominator[0]
    b = [c / lead for c in reversed(table.numerator)] + [0.0] * (3 - len(table.numerator))
    a = [c / lead for c in reversed(table.denominator[1:])]
    return Lag(tuple(b), tuple(a))


def _shape(shape: BoxShape | SphereShape) -> BuoyancyShape:
    if isinstance(shape, BoxShape):
        x, y, z = shape.size_m
        return BuoyancyShape(SHAPE_BOX, shape.center_frd_m, (x / 2, y / 2, z / 2), x * y * z)
    volume = 4.0 / 3.0 * math.pi * shape.radius_m**3
    return BuoyancyShape(SHAPE_SPHERE, shape.center_frd_m, (shape.radius_m, 0.0, 0.0), volume)


def _rigid_body(body: RigidBody) -> FloatArray:
    if not isinstance(body.inertia_matrix_kgm2, UnsetType):
        inertia = np.array(body.inertia_matrix_kgm2)
    else:
        # Without any inertia, which the checks of the vehicle report, other checks go on with zeros.
        inertia = np.zeros((3, 3)) if isinstance(body.inertia_kgm2, UnsetType) else np.diag(body.inertia_kgm2)
    if body.inertia_about == "origin":
        # Back from the origin to the centre of mass, by the parallel axis theorem.
        inertia = inertia - rigid_body_inertia(body.mass_kg, np.zeros((3, 3)), body.center_of_mass_frd_m)[3:, 3:]
    return rigid_body_inertia(body.mass_kg, inertia, body.center_of_mass_frd_m)


def _matrix(coefficients: Coefficients | UnsetType) -> FloatArray:
    if isinstance(coefficients, UnsetType):
        return np.zeros((6, 6))
    if not isinstance(coefficients.matrix, UnsetType):
        return np.array(coefficients.matrix)
    return np.zeros((6, 6)) if coefficients.diagonal is UNSET else np.diag(np.array(coefficients.diagonal))
