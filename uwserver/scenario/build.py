"""From a resolved scenario to a World: the only place that brings concrete classes together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from functools import partial

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.actuators import ActuatorConfig, Body
from uwserver.environment.earth import NO_FIELD, Earth
from uwserver.environment.materials import lambert
from uwserver.frames import quat_from_rpy
from uwserver.modifiers import Modifier, Stream
from uwserver.physics.hydrodynamics import Hydrodynamics
from uwserver.physics.layout import NU, P, Q
from uwserver.ports import Field, Port
from uwserver.scenario.body import body_params
from uwserver.scenario.epoch import instant, nanoseconds, year_of
from uwserver.scenario.magnetic import magnetic_about
from uwserver.scenario.resolved import Resolved, ResolvedVehicle
from uwserver.scenario.schema import Environment
from uwserver.scenario.sea import water_of
from uwserver.scenario.vehicle_schema import Vehicle as VehicleFile
from uwserver.sensors import Compound, CompoundConfig, Instrument, MagnetometerConfig, Pose, Sensor, SensorConfig
from uwserver.sensors.truth import TRUTH
from uwserver.sensors.wiring import Electric, Wiring
from uwserver.services import offer_world_services
from uwserver.slots import ActuatorSlot, SensorSlot
from uwserver.units import NANOSECONDS, rad
from uwserver.vehicle import Vehicle
from uwserver.world import World


def physics_rate(rate_hz: float) -> Fraction:
    """The rate as the exact rational that the user wrote in decimals."""
    return Fraction(str(rate_hz))


def build(resolved: Resolved, seed: int | None = None) -> World:
    """A world at t = 0.

    Args:
        resolved: a loaded and checked scenario.
        seed: instead of the scenario's.
    """
    scenario = resolved.scenario
    rate = physics_rate(scenario.world.rate_hz)
    hydro = Hydrodynamics((), float(1 / rate))
    seed = scenario.seed if seed is None else seed
    water = water_of(scenario.environment, float(rate), partial(stream_of, seed))
    hydro.sea = None if water.sea is None else water.sea.rows
    hydro.load_kernels()
    world = World(resolved.name, rate, seed, scenario.world.epoch_utc, hydro, water)
    world.earth = _earth(resolved)
    world.lambert = lambert(resolved.materials)
    for vehicle in resolved.vehicles.values():
        _install(world, vehicle, scenario.environment)
    world.set_current(water.current)
    for name, fault in scenario.faults.items():
        world.faults.set(name, fault, world.tick)
    offer_world_services(world)
    return world


def _earth(resolved: Resolved) -> Earth:
    """Where N lies. The magnetic field costs a moment, and is computed where a magnetometer or a magnetic heading asks for it."""
    table = resolved.scenario.world
    epoch = instant(table.epoch_utc)
    if isinstance(table.origin_lat_deg, UnsetType) or isinstance(table.origin_lon_deg, UnsetType):
        return Earth(epoch_ns=nanoseconds(epoch))
    latitude, longitude = rad(table.origin_lat_deg), rad(table.origin_lon_deg)
    sensors = [config for vehicle in resolved.vehicles.values() for config in vehicle.vehicle.sensors.values()]
    magnetic = any(isinstance(c, MagnetometerConfig) or getattr(c, "north", "") == "magnetic" for c in sensors)
    field = magnetic_about(latitude, longitude, year_of(epoch)) if magnetic else NO_FIELD
    return Earth(latitude, longitude, nanoseconds(epoch), field)


def _install(world: World, resolved: ResolvedVehicle, environment: Environment) -> None:
    file, entry, name = resolved.vehicle, resolved.entry, resolved.name
    hydro = world.hydro
    first_thruster, first_wrench, first_servo = len(hydro.thrusters), len(hydro.wrenches), len(hydro.servos)
    params = body_params(file, resolved.devices, environment)
    row = hydro.add(params)
    roll, pitch, yaw = (rad(angle) for angle in entry.attitude_rpy_deg)
    state = hydro.state[row]
    state[P : P + 3] = entry.position_ned_m
    state[Q : Q + 4] = quat_from_rpy(roll, pitch, yaw)
    state[NU : NU + 3] = entry.velocity_frd_mps
    state[NU + 3 : NU + 6] = [rad(rate) for rate in entry.angular_velocity_frd_degps]
    thrusters = {thruster: first_thruster + k for k, thruster in enumerate(file.thrusters)}
    servos = {servo.name: first_servo + k for k, servo in enumerate(params.appendages.servos)}
    body = Body(hydro, row, thrusters, first_wrench, servos)
    wiring = Wiring(hydro, row, thrusters, _electrics(resolved))
    built: dict[str, SensorSlot] = {}
    for key, config in sorted(file.sensors.items(), key=lambda item: isinstance(item[1], CompoundConfig)):
        built[key] = _sensor(world, f"{name}/{key}", config, file, row, built)
    for slot in built.values():
        slot.wiring = wiring
    sensors = list(built.values())
    if not isinstance(entry.truth, UnsetType):
        sensors += _truth(world, name, entry.truth.rate_hz, row)
    actuators = [_actuator(world, f"{name}/{key}", config, body) for key, config in file.actuators.items()]
    world.install([Vehicle(name, file.name, row, hydro)], sensors, actuators)


def _electrics(resolved: ResolvedVehicle) -> dict[str, Electric]:
    tables = {name: device.electric for name, device in resolved.devices.items()}
    return {
        name: Electric(table.power_WpN15, table.speed_radpspN05)
        for name, table in tables.items()
        if not isinstance(table, UnsetType)
    }


def mount_of(config: SensorConfig, file: VehicleFile) -> Pose:
    """X_BS of a sensor: its mount's, or its own."""
    place = config if config.mount is UNSET else file.mounts[str(config.mount)]
    roll, pitch, yaw = (rad(angle) for angle in place.rpy_deg)
    return Pose(place.position_frd_m, quat_from_rpy(roll, pitch, yaw))


def _sensor(
    world: World, path: str, config: SensorConfig, file: VehicleFile, row: int, built: Mapping[str, SensorSlot]
) -> SensorSlot:
    sensor: Sensor = config.build(mount_of(config, file))
    divisor = round(world.rate_hz / physics_rate(config.rate_hz))
    if isinstance(sensor, Instrument):
        sensor.dt = float(divisor / world.rate_hz)
        sensor.start(stream_of(world.seed, path))
    if isinstance(sensor, Compound):
        sensor.join(built)
    kind = str(config.__struct_config__.tag)
    port = Port(path, "sensor", kind, sensor.fields, sensor.doc, float(world.rate_hz / divisor))
    modifiers: list[Modifier] = [
        modifier.build(Stream(sensor.fields, float(divisor / world.rate_hz), stream_of(world.seed, f"{path}/{key}")))
        for key, modifier in config.modifiers.items()
    ]
    return SensorSlot(port, row, sensor, tuple(modifiers), divisor, round(config.latency_s * NANOSECONDS))


def stream_of(seed: int, path: str) -> np.random.Generator:
    """The random stream of one path: it depends on nothing but the scenario's seed and the path itself."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=tuple(path.encode()))))


def _truth(world: World, vehicle: str, rate_hz: float, row: int) -> Iterable[SensorSlot]:
    divisor = round(world.rate_hz / physics_rate(rate_hz))
    for name, kind in TRUTH.items():
        sensor = kind()
        path = f"{vehicle}/truth/{name}"
        port = Port(path, "sensor", f"truth_{name}", sensor.fields, sensor.doc, float(world.rate_hz / divisor))
        yield SensorSlot(port, row, sensor, (), divisor, 0)


def _actuator(world: World, path: str, config: ActuatorConfig, body: Body) -> ActuatorSlot:
    actuator = config.build(body)
    fields: tuple[Field, ...] = actuator.fields
    kind = str(config.__struct_config__.tag)
    timeout = config.timeout_s or None
    port = Port(path, "actuator", kind, fields, actuator.doc, timeout_s=timeout)
    return ActuatorSlot(port, actuator, round(physics_rate(config.timeout_s) * world.rate_hz))
