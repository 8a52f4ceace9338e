"""From a resolved scenario to a World: the only place that brings concrete classes together."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.actuators import ActuatorConfig, Body
from uwserver.environment.column import WaterColumn
from uwserver.environment.materials import lambert
from uwserver.environment.water import Water
from uwserver.frames import quat_from_rpy
from uwserver.modifiers import Modifier, Stream
from uwserver.physics.hydrodynamics import Hydrodynamics
from uwserver.physics.layout import NU, P, Q
from uwserver.ports import Field, Port
from uwserver.scenario.body import body_params
from uwserver.scenario.resolved import Resolved, ResolvedVehicle
from uwserver.scenario.schema import Environment
from uwserver.scenario.vehicle_schema import Vehicle as VehicleFile
from uwserver.sensors import Instrument, Pose, Sensor, SensorConfig
from uwserver.sensors.truth import TRUTH
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
    hydro.load_kernels()
    water = _water(scenario.environment)
    seed = scenario.seed if seed is None else seed
    world = World(resolved.name, rate, seed, scenario.world.epoch_utc, hydro, water)
    world.lambert = lambert(resolved.materials)
    for vehicle in resolved.vehicles.values():
        _install(world, vehicle, scenario.environment)
    world.set_current(water.current)
    offer_world_services(world)
    return world


def _water(environment: Environment) -> Water:
    density, gravity, config = environment.density_kgpm3, environment.gravity_mps2, environment.water
    return Water(
        density=density,
        gravity=gravity,
        temperature=environment.temperature_degc,
        atmospheric_pressure=environment.atmospheric_pressure_pa,
        current=environment.current.velocity_ned_mps,
        given=None if isinstance(config, UnsetType) else WaterColumn(config, gravity, density),
    )


def _install(world: World, resolved: ResolvedVehicle, environment: Environment) -> None:
    file, entry, name = resolved.vehicle, resolved.entry, resolved.name
    hydro = world.hydro
    first_thruster, first_wrench = len(hydro.thrusters), len(hydro.wrenches)
    row = hydro.add(body_params(file, resolved.devices, environment))
    roll, pitch, yaw = (rad(angle) for angle in entry.attitude_rpy_deg)
    state = hydro.state[row]
    state[P : P + 3] = entry.position_ned_m
    state[Q : Q + 4] = quat_from_rpy(roll, pitch, yaw)
    state[NU : NU + 3] = entry.velocity_frd_mps
    state[NU + 3 : NU + 6] = [rad(rate) for rate in entry.angular_velocity_frd_degps]
    thrusters = {thruster: first_thruster + k for k, thruster in enumerate(file.thrusters)}
    body = Body(hydro, row, thrusters, first_wrench)
    sensors = [_sensor(world, f"{name}/{key}", config, file, row) for key, config in file.sensors.items()]
    if not isinstance(entry.truth, UnsetType):
        sensors += _truth(world, name, entry.truth.rate_hz, row)
    actuators = [_actuator(world, f"{name}/{key}", config, body) for key, config in file.actuators.items()]
    world.install([Vehicle(name, file.name, row, hydro)], sensors, actuators)


def mount_of(config: SensorConfig, file: VehicleFile) -> Pose:
    """X_BS of a sensor: its mount's, or its own."""
    place = config if config.mount is UNSET else file.mounts[str(config.mount)]
    roll, pitch, yaw = (rad(angle) for angle in place.rpy_deg)
    return Pose(place.position_frd_m, quat_from_rpy(roll, pitch, yaw))


def _sensor(world: World, path: str, config: SensorConfig, file: VehicleFile, row: int) -> SensorSlot:
    sensor: Sensor = config.build(mount_of(config, file))
    if isinstance(sensor, Instrument):
        sensor.start(stream_of(world.seed, path))
    divisor = round(world.rate_hz / physics_rate(config.rate_hz))
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
