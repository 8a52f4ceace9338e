"""Builds the autopilot of a vehicle from its tables: its sensors, its actuators, and how strong they are."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np
from msgspec import UnsetType, structs

from uwserver.actuators import Devices
from uwserver.autopilot.allocation import (
    Allocation,
    FinEffect,
    Shaft,
    Thrust,
    fin_allocation,
    thruster_allocation,
    wrench_allocation,
)
from uwserver.autopilot.config import AutopilotConfig, Gains
from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.ports import TEST_TIMEOUT_S, StateSensor, services, set_points
from uwserver.autopilot.state import Six
from uwserver.autopilot.vehicle_spec import (
    Dynamics,
    Held,
    SensorInput,
    SensorInputs,
    SiteData,
    VehicleSpec,
    fields_used,
)
from uwserver.frames import Vec3
from uwserver.modifiers import WhiteNoise
from uwserver.physics.dynamics.params import BodyParams, ThrusterParams, shape_rows
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import SHAPE_SPHERE
from uwserver.ports import Port, Service
from uwserver.scenario.load.resolved import ResolvedVehicle
from uwserver.scenario.vehicle.checks import commanded_tables
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.sensors import Pose, SensorConfig
from uwserver.world.parts.part import Carry
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.stepping.commands import ActuatorSlot
from uwserver.world.stepping.piloting import Piloting
from uwserver.world.world import World

RATE_HZ, STATE_RATE_HZ = 60, 10
_ONLY_ONE = ("Imu", "Attitude", "FluidPressure", "BatteryState")
_LEAST_UP_M, _AWASH_M = 0.3, 0.1
"""A vehicle has surfaced when its origin is no deeper than the first, or the top of its displaced volume no deeper than the second."""
_UNKNOWN_PUSH = 0.5
"""Largest acceleration (m/s2, rad/s2) assumed for a vehicle without thrusters, if its file gives no limit."""


@dataclass(frozen=True)
class Piloted:
    """An autopilot with its ports and services."""

    part: Piloting
    state: SensorSlot
    set_points: tuple[ActuatorSlot, ...]
    services: tuple[tuple[Service, Carry], ...]


def build_autopilot(
    world: World,
    resolved: ResolvedVehicle,
    params: BodyParams,
    name: str,
    row: int,
    mounts: Mapping[str, Pose],
    ports: Mapping[str, Port],
    actuators: Mapping[str, ActuatorSlot],
) -> Piloted | None:
    """Return the autopilot of a vehicle of a checked scenario; None if it has none.

    Args:
        world, resolved, params: the world, and tables and parameters of the vehicle.
        name: first level of its paths.
        row: row of its body.
        mounts: X_BS of its sensors.
        ports: ports of its sensors, by path.
        actuators: its actuators, by their names in the vehicle file.
    """
    config = resolved.entry.autopilot
    if isinstance(config, UnsetType):
        return None
    file, path = resolved.vehicle, f"{name}/autopilot"
    gains = gains_of(file, config)
    divisor = divisor_of(world.rate_hz, config.rate_hz, RATE_HZ)
    dt = float(divisor / world.rate_hz)
    holding = _HeldActuators()
    allocation, dynamics = _controls(file, params, actuators, holding)
    allocation.devices["row"], allocation.devices["full"] = holding.rows, holding.full
    spec = VehicleSpec(
        path=path,
        inputs=SensorInputs(_sensor_inputs(world, file, name, mounts, ports), _site_data(world, file, config)),
        allocation=allocation,
        dynamics=dynamics,
        held=holding.held,
        shares=holding.shares,
        names=tuple(holding.names),
        blocked=holding.blocked,
        gains=gains,
        divisor=divisor,
        dt=dt,
        up=_up(params),
        mode=config.mode,
        armed=config.armed,
        on_leak=config.on_leak,
        on_low_battery=config.on_low_battery,
    )
    pilot = Autopilot(spec, lambda: (world.tick, world.t_ns), lambda text: world.say("autopilot", text), world.answers)
    slots = dict(_set_point_slots(world, path, pilot, config))
    pilot.set_points = {name: slot for name, slot in slots.items() if name != "pilot"}
    pilot.begin()
    state = _state_slot(world, path, pilot, config, row)
    return Piloted(Piloting(pilot), state, tuple(slots.values()), tuple(services(pilot)))


def _up(params: BodyParams) -> float:
    """Return the depth of the origin (m) at which the vehicle has surfaced. A tall one floats with its origin far below its top."""
    tops = [
        float(shape["half"][0 if shape["kind"] == SHAPE_SPHERE else 2] - shape["center"][2])
        for shape in shape_rows(params)
    ]
    return max(_LEAST_UP_M, max(tops, default=0.0) + _AWASH_M)


def gains_of(file: VehicleFile, config: AutopilotConfig) -> Gains:
    """Return the gains of the vehicle file, replaced by those of the scenario.

    Raises:
        msgspec.ValidationError: a name or a value is wrong.
    """
    own = Gains() if isinstance(file.autopilot, UnsetType) else file.autopilot.gains
    return msgspec.convert({**structs.asdict(own), **config.gains}, Gains)


def divisor_of(physics: Fraction, wanted: float | UnsetType, most: int) -> int:
    """Return the ticks of a step; by default the fewest that give at most `most` steps a second."""
    if isinstance(wanted, UnsetType):
        return max(1, math.ceil(physics / most))
    return round(physics / Fraction(str(wanted)))


def _set_point_slots(
    world: World, path: str, pilot: Autopilot, config: AutopilotConfig
) -> Iterator[tuple[str, ActuatorSlot]]:
    """Yield the ports for commands, by name."""
    timeouts = {"pilot": config.pilot_timeout_s, "test": TEST_TIMEOUT_S}
    timeouts |= dict.fromkeys(("velocity", "attitude"), config.setpoint_timeout_s)
    for name, point in set_points(pilot):
        timeout = timeouts.get(name, 0.0)
        port = Port(f"{path}/{name}", "actuator", "autopilot", point.fields, point.doc, timeout_s=timeout or None)
        yield name, ActuatorSlot(port, point, world.rate_hz, round(Fraction(str(timeout)) * world.rate_hz))


def _state_slot(world: World, path: str, pilot: Autopilot, config: AutopilotConfig, row: int) -> SensorSlot:
    sensor = StateSensor(pilot)
    sensor.start(0)
    divisor = divisor_of(world.rate_hz, config.state_rate_hz, STATE_RATE_HZ)
    rate = float(world.rate_hz / divisor)
    port = Port(f"{path}/state", "sensor", "autopilot", sensor.fields, sensor.doc, rate, message="Estimate")
    return SensorSlot(sensor, (SensorStream(port),), row, world.rate_hz, divisor)


# -- sensors --------------------------------------------------------------------------------------------------------------------------------


def _sensor_inputs(
    world: World, file: VehicleFile, name: str, mounts: Mapping[str, Pose], ports: Mapping[str, Port]
) -> dict[str, SensorInput]:
    found: dict[str, SensorInput] = {}
    taken: set[str] = set()
    names = {
        key: {field.name for field in ports[config.port_of(name, key)].fields} for key, config in file.sensors.items()
    }
    # Of two pressure sensors it takes the one that reports depth.
    for key, sensor in sorted(file.sensors.items(), key=lambda item: "pressure" in names[item[0]]):
        message, fields = sensor.message, ports[sensor.port_of(name, key)].fields
        takes = fields_used(message, fields)
        if not takes or not names[key].issuperset(takes) or (message in _ONLY_ONE and message in taken):
            continue
        taken.add(message)
        mount = mounts[key]
        density = atmosphere = 0.0
        if "pressure" in takes:
            density, atmosphere = world.water.density * world.water.gravity, world.water.atmospheric_pressure
        found[f"{name}/{key}"] = SensorInput(
            message=message,
            fields=fields,
            p=mount.p,
            q=mount.q,
            sigma=_sigma(sensor),
            north=world.earth.declination if getattr(sensor, "north", "") == "magnetic" else 0.0,
            density=density,
            atmosphere=atmosphere,
        )
    return found


def _sigma(sensor: SensorConfig) -> float:
    """Return the standard deviation of a position that the operator expects from the data sheet, m."""
    if sensor.traits().beacons:
        return 0.3
    noise = [m.sigma for m in sensor.modifiers.values() if isinstance(m, WhiteNoise) and m.field == "p_NS"]
    return max([0.01, *noise])


def _site_data(world: World, file: VehicleFile, config: AutopilotConfig) -> SiteData:
    beacons: dict[str, Vec3] = {}
    for sensor in file.sensors.values():
        beacons |= {each.name: each.p for each in sensor.traits().beacons if each.body is None and not each.moves}
    start = None if isinstance(config.start_position_ned_m, UnsetType) else config.start_position_ned_m
    return SiteData(world.water.gravity, world.earth.latitude, world.earth.longitude, beacons, start)


# -- actuators ------------------------------------------------------------------------------------------------------------------------------


@dataclass
class _HeldActuators:
    """The actuators that an autopilot commands, and others on the same devices, which it only blocks.

    Attributes:
        held, blocked: actuators that it commands, in the order of the allocation; and those that it blocks.
        shares: number of devices of each held actuator.
        names, rows, full: the devices: their names, their rows in the bodies' arrays, and their full commands.
    """

    held: list[Held] = field(default_factory=list)
    blocked: list[Held] = field(default_factory=list)
    shares: list[int] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    rows: list[int] = field(default_factory=list)
    full: list[float] = field(default_factory=list)

    def hold(self, slot: ActuatorSlot, names: Sequence[str], strongest: float = 0.0) -> None:
        """Hold an actuator. The full command of a field is its maximum, or `strongest` if it has none."""
        actuator: Any = slot.actuator
        self.held.append(slot)
        self.shares.append(len(names))
        self.names += names
        self.rows += actuator.rows.values() if isinstance(actuator.rows, Mapping) else actuator.rows
        for given in slot.port.fields:
            self.full += (given.maximum or strongest,) * given.size


def _controls(
    file: VehicleFile, params: BodyParams, actuators: Mapping[str, ActuatorSlot], holding: _HeldActuators
) -> tuple[Allocation, Dynamics]:
    inertia = _six(np.diag(params.M_RB + params.M_A))
    tables = commanded_tables(file.actuators.values())
    if {"fins", "propellers"} <= tables:
        allocation, shaft = _fins(file, params, actuators, holding)
        righting = params.weight * params.r_g[2] - params.buoyancy * params.r_b[2]
        return allocation, Dynamics(inertia, allocation.reach, righting=righting, shaft=shaft)
    if "thrusters" in tables:
        allocation = _thrusters(file, params, actuators, holding)
    else:
        key = next(k for k, c in file.actuators.items() if c.message == "Wrench")
        holding.hold(actuators[key], [f"{part}.{axis}" for part in ("force", "moment") for axis in "xyz"])
        allocation = wrench_allocation(_wrench_limits(file, params))
    linear, quadratic = _six(np.diag(params.D_L)), _six(np.diag(params.D_Q))
    return allocation, Dynamics(inertia, allocation.reach, linear, quadratic)


def _devices(
    file: VehicleFile,
    table: str,
    everything: tuple[str, ...],
    actuators: Mapping[str, ActuatorSlot],
    holding: _HeldActuators,
    strongest: float = 0.0,
) -> Iterator[tuple[Devices, tuple[str, ...]]]:
    """Hold the actuators of devices in a table, those with many devices first, and yield them with the names. No device comes twice."""
    found = {key: config.devices() for key, config in file.actuators.items()}
    members = {
        key: (devices, devices.members or everything)
        for key, devices in found.items()
        if devices is not None and devices.table == table
    }
    seen: set[str] = set()
    for key, (devices, names) in sorted(members.items(), key=lambda item: -len(item[1][1])):
        if seen.intersection(names):
            holding.blocked.append(actuators[key])
            continue
        seen.update(names)
        holding.hold(actuators[key], [f"{table}.{name}" for name in names], strongest)
        yield devices, names


def _six(values: FloatArray) -> Six:
    a, b, c, d, e, f = values.tolist()
    return (a, b, c, d, e, f)


def _thrusters(
    file: VehicleFile, params: BodyParams, actuators: Mapping[str, ActuatorSlot], holding: _HeldActuators
) -> Allocation:
    by_name = {thruster.name: _thrust(thruster) for thruster in params.thrusters}
    strongest = max(thrust.curve[-1][1] for thrust in by_name.values())
    groups = [
        (tuple(by_name[name] for name in names), devices.field == "force_N")
        for devices, names in _devices(file, "thrusters", tuple(by_name), actuators, holding, strongest)
    ]
    return _shared_allocation(tuple(groups))


@lru_cache(maxsize=16)
def _shared_allocation(groups: tuple[tuple[tuple[Thrust, ...], bool], ...]) -> Allocation:
    """Return an allocation, which all vehicles alike share, because it has no state."""
    return thruster_allocation(groups)


@lru_cache(maxsize=128)
def _thrust(thruster: ThrusterParams) -> Thrust:
    axis = np.array(thruster.axis) / np.linalg.norm(thruster.axis)
    column = np.concatenate([axis, np.cross(thruster.r, axis) + thruster.torque_per_force * axis])
    voltages = thruster.table.voltages
    nearest = min(range(len(voltages)), key=lambda k: abs(voltages[k] - thruster.voltage))
    return Thrust(_six(column), tuple((u, force * thruster.installed) for u, force in thruster.table.curves[nearest]))


def _wrench_limits(file: VehicleFile, params: BodyParams) -> Six:
    own = file.autopilot
    if not isinstance(own, UnsetType) and not isinstance(own.max_wrench, UnsetType):
        return own.max_wrench
    return _six(_UNKNOWN_PUSH * np.diag(params.M_RB + params.M_A))


def _fins(
    file: VehicleFile, params: BodyParams, actuators: Mapping[str, ActuatorSlot], holding: _HeldActuators
) -> tuple[Allocation, Shaft]:
    fins = [
        _fin(params, f"fins.{name}")
        for _, names in _devices(file, "fins", tuple(file.fins), actuators, holding)
        for name in names
    ]
    propellers = [
        (key, devices.members[0])
        for key, config in file.actuators.items()
        if (devices := config.devices()) is not None and devices.table == "propellers"
    ]
    for key, member in propellers:
        holding.hold(actuators[key], (f"propellers.{member}",))
    shaft = _shaft(params, f"propellers.{propellers[0][1]}")
    shaft = replace(shaft, strength=len(propellers) * shaft.strength)
    return fin_allocation(fins, shaft, len(propellers)), shaft


def _fin(params: BodyParams, servo: str) -> FinEffect:
    """Return the effect of a fin's foil and published derivatives, straight ahead at 1 m/s and for small angles."""
    column = np.zeros(6)
    for foil in params.appendages.foils:
        if foil.servo == servo:
            normal = np.cross(foil.hinge, foil.chord)
            force = foil.pressure_area * foil.slope * normal / np.linalg.norm(normal)
            column += np.concatenate([force, np.cross(foil.r, force)])
    for term in params.appendages.derivatives:
        if term.servo == servo and term.power == 1 and term.j == term.k == 0:
            column[term.axis] += term.coefficient
    limits = next(s for s in params.appendages.servos if s.name == servo)
    return FinEffect(_six(column), min(-limits.low, limits.high))


def _shaft(params: BodyParams, servo: str) -> Shaft:
    propeller = next(p for p in params.appendages.propellers if p.servo == servo)
    limit = next(s for s in params.appendages.servos if s.name == servo).high
    rest, fall, astern = propeller.line
    strength = propeller.density * propeller.diameter**4 * propeller.deduction
    return Shaft(rest, fall, strength, propeller.wake, propeller.diameter, astern, limit)
