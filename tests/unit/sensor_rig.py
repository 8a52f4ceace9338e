"""What tests of single kinds of sensor share: a place on the Earth, a sea, sensors just switched on, and vehicles that carry them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uwserver.environment.column import TableColumn, ThermoclineColumn, WaterColumn
from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.frames import conjugate, quat_from_rpy, rotate
from uwserver.modifiers import Measurement
from uwserver.physics.kernel.random import key_of
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.earth import magnetic_about
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import (
    BatteryConfig,
    LblConfig,
    Pose,
    SensorConfig,
    UsblConfig,
)
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.units import rad
from uwserver.world import World

EARTH = Earth(rad(63.43), rad(10.40), 1_767_225_600_000_000_000, magnetic_about(rad(63.43), rad(10.40), 2026.5))

MOUNT = Pose((0.3, -0.2, -0.1), quat_from_rpy(0.4, -0.3, 2.0))

Q = quat_from_rpy(0.1, -0.2, 1.3)

CAST = TableColumn(depth_m=(0.0, 10.0, 20.0), temperature_degc=(18.0, 18.0, 8.0), salinity_psu=(30.0, 30.0, 35.0))

SEA = Water(1023.0, 9.81, 18.0, 101_325.0, (0.0, 0.0, 0.0), given=WaterColumn(CAST, 9.81, 1023.0))


def started(config, seed=1, dt=None, mount=MOUNT):
    sensor = config.build(mount)
    sensor.dt = 1.0 / config.rate_hz if dt is None else dt
    sensor.start(key_of(seed, "rov/x"))
    return sensor


def at(scope, t, **changes):
    return replace(scope(earth=EARTH, **changes), t_ns=round(t * 1e9))


THRUSTERS = tuple(f"t{k}" for k in range(1, 9))


def world_with(depth=20.0, seed=1, **sensors: SensorConfig) -> World:
    entry = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, depth), sensors=sensors)
    place = WorldTable(origin_lat_deg=63.4, origin_lon_deg=10.4)
    return build(load(Scenario(schema=1, seed=seed, world=place, vehicles={"rov": entry}), adapters={}))


def last(world: World, port: str, ticks: int):
    return next(s for s in reversed(world.step(ticks)) if s.port == f"rov/{port}").value


def full_speed(world: World, seconds: float, port: str, u: float = 1.0):
    for _ in range(round(seconds * 2)):
        world.command("rov/thrusters", u=[u] * 8)
        value = last(world, port, 120)
    return value


BATTERY = BatteryConfig(
    rate_hz=20, capacity_Ah=18.0, cell_curve_V=(3.0, 3.7, 4.2), resistance_ohm=0.05, hotel_load_W=20.0
)


def electromotive(config: BatteryConfig, charge: float) -> float:
    """Voltage (V) of a battery without load, at a part of its capacity."""
    curve = config.cell_curve_V
    return config.cells * float(np.interp(charge, np.linspace(0.0, 1.0, len(curve)), curve))


PLACES = {"a": (120.0, 40.0, 60.0), "b": (-80.0, 150.0, 55.0), "c": (30.0, -200.0, 58.0)}

BEACONS = {name: Beacon(position_ned_m=p, turn_around_s=0.1) for name, p in PLACES.items()}

LBL, USBL = (kind(rate_hz=10, ideal=True, beacons=BEACONS) for kind in (LblConfig, UsblConfig))

CUBE = (
    (0.015, 0.0, 0.0),
    (-0.015, 0.0, 0.0),
    (0.0, 0.015, 0.0),
    (0.0, -0.015, 0.0),
    (0.0, 0.0, 0.015),
    (0.0, 0.0, -0.015),
)

NAME, RANGE = 0, 1

BEARING, ELEVATION, P_S, TIME, EACH = range(2, 7)


@dataclass
class Carrier:
    """A vehicle that carries a beacon."""

    p_NB: tuple[float, float, float]
    q_NB: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    nu: tuple[float, ...] = (0.0,) * 6


def exchange(device, instant):
    """Validity and values of an exchange in a world that stands still, but for beacons that drift."""
    device.memory.ready = 0.0
    return device.measure(instant)


def answers(config, instant, n, seed=0):
    """Those of n exchanges, one after the other."""
    device = config.build(Pose())
    device.start(seed)
    return [Measurement(*exchange(device, instant)[::-1]) for _ in range(n)]


TILTED = {"p_NB": (3.0, -4.0, 6.0), "q_NB": quat_from_rpy(0.2, -0.1, 2.0)}


def layered(scope):
    column = ThermoclineColumn(surface_temperature_degc=18.0, deep_temperature_degc=6.0, depth_m=40.0, thickness_m=20.0)
    instant = scope(p_NB=(0.0, 0.0, 5.0))
    instant.water = Water(1025.0, 9.81, 18.0, 101325.0, (0.0, 0.0, 0.0), given=WaterColumn(column, 9.81, 1025.0))
    return instant


def moving(scope, p, v, w=(0.0, 0.0, 0.0), rate_hz=240):
    """Instants at the ticks of a vehicle that starts level at p with constant v (N) and turns about its z."""
    for k in range(10_000):
        t = k / rate_hz
        q = quat_from_rpy(0.0, 0.0, w[2] * t)
        at = tuple(a + b * t for a, b in zip(p, v, strict=True))
        yield scope(p_NB=at, q_NB=q, v_NB_B=rotate(conjugate(q), v), w_NB_B=w, t_ns=round(t * 1e9))


def first(device, instants):
    return next(reading for reading in map(device.sense, instants) if reading is not None)
