"""What holds for every kind of sensor, in one place: ideal it is the truth to 1e-9, it says when it cannot measure, and what can be set can be set.

A kind that has no test of its own must be in each table, so that a new one cannot be forgotten.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sensor_rig
from msgspec import structs
from scipy.spatial.transform import Rotation

from uwserver.adapter import installed_adapters
from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.frames import quat_from_rpy
from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.load.scenario import load
from uwserver.sensors import Pose, Scope, SensorConfig
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.testing import FakeGeometry
from uwserver.testing.fake_geometry import Plane
from uwserver.testing.sensors import measured

KINDS = tuple(kinds_of(SensorConfig))
G, DENSITY, ATMOSPHERE = 9.81, 1025.0, 101_325.0
BOTTOM, WALL = 30.0, 20.0
P, RPY = (3.0, -2.0, 11.0), (0.05, -0.04, 0.3)
V, W = np.array((0.7, -0.3, 0.1)), np.array((0.1, -0.2, 0.3))
V_DOT, W_DOT = np.array((0.2, 0.1, -0.3)), np.array((0.01, 0.03, -0.02))
CURRENT = np.array((0.3, -0.1, 0.05))
MOUNT = Pose((0.2, -0.1, 0.15), quat_from_rpy(0.02, -0.03, 0.1))
MAGNETIC = np.array((1.4e-5, 1.2e-6, 5.0e-5))
WATER = Water(DENSITY, G, 12.0, ATMOSPHERE, tuple(CURRENT))
SCOPE = Scope(
    2_500_000_000, P, quat_from_rpy(*RPY), tuple(V), tuple(W), WATER, (*V_DOT, *W_DOT),
    geometry=FakeGeometry([Plane((0.0, 0.0, BOTTOM), (0.0, 0.0, -1.0)), Plane((WALL, 0.0, 0.0), (-1.0, 0.0, 0.0))]),
    earth=Earth(1.1, 0.2, 1_767_225_600_000_000_000, (tuple(MAGNETIC), *[(0.0, 0.0, 0.0)] * 3)),
)  # fmt: skip

NB = Rotation.from_euler("ZYX", RPY[::-1])
BS = Rotation.from_quat([*MOUNT.q[1:], MOUNT.q[0]])
NS = NB * BS
P_NS = np.array(P) + NB.apply(MOUNT.p)
V_NS = NB.apply(V + np.cross(W, MOUNT.p))
ACCELERATION = V_DOT + np.cross(W, V) + np.cross(W_DOT, MOUNT.p) + np.cross(W, np.cross(W, MOUNT.p))
AXIS = NS.apply((0.0, 0.0, 1.0))
C = WATER.sound_speed(P_NS[2])


@pytest.fixture(scope="module")
def shipped():
    """One sensor of each kind, with all errors that its device or the example has."""
    resolved = load("one_of_everything", adapters=installed_adapters())
    found = {}
    for sensor in resolved.vehicles["heavy"].vehicle.sensors.values():
        found[sensor.__struct_config__.tag] = sensor
    return found


@pytest.fixture(scope="module")
def world():
    """All of them in a world, ideal, under power."""
    resolved = load("one_of_everything", adapters=installed_adapters())
    vehicle = resolved.vehicles["heavy"]
    sensors = {name: perfect(sensor) for name, sensor in vehicle.vehicle.sensors.items()}
    sensors["shafts"] = structs.replace(sensors["shafts"], members=("t1", "t5"))
    vehicle = replace(vehicle, vehicle=structs.replace(vehicle.vehicle, sensors=sensors))
    world = build(replace(resolved, vehicles={**resolved.vehicles, "heavy": vehicle}))
    world.command("heavy/thrusters", u=[0.2] * 4 + [0.0] * 4)
    world.call("heavy/leak/set", area_m2=1e-3)
    world.step(960)
    return world


def perfect(sensor):
    changes = {"ideal": True} if "ideal" in sensor.__struct_fields__ else {}
    return structs.replace(sensor, modifiers={}, streams={}, **changes)


def beacon_of(sensor):
    """Place (N) of the first beacon."""
    beacon = next(iter(sensor.beacons.values()))
    return np.array(beacon.position_ned_m)


def usbl(sensor):
    p_S = NS.inv().apply(beacon_of(sensor) - P_NS)
    reach = np.linalg.norm(p_S)
    phones = np.linalg.norm(p_S - np.array(sensor.hydrophones_m), axis=1)
    return {
        "range": reach, "bearing": math.atan2(p_S[1], p_S[0]), "elevation": math.asin(p_S[2] / reach), "p_beacon_S": p_S,
        "travel_time": 2.0 * reach / C, "hydrophone_ranges": phones,
    }  # fmt: skip


def lbl(sensor):
    reach = np.linalg.norm(beacon_of(sensor) - P_NS)
    return {"range": reach, "travel_time": 2.0 * reach / C}


def dvl(sensor):
    angle, azimuths = np.radians(sensor.beam_angle_deg), np.radians(sensor.beam_azimuth_deg)
    beams = np.array([(np.sin(angle) * np.cos(a), np.sin(angle) * np.sin(a), np.cos(angle)) for a in azimuths])
    v_S = NS.inv().apply(V_NS)
    return {
        "v_S": v_S, "altitude": (BOTTOM - P_NS[2]) / AXIS[2], "beam_velocities": beams @ v_S, "beam_locks": [True] * 4,
        "beam_ranges": (BOTTOM - P_NS[2]) / NS.apply(beams)[:, 2], "v_water_S": NS.inv().apply(V_NS - CURRENT),
    }  # fmt: skip


def adcp(sensor):
    angle, azimuths = np.radians(sensor.beam_angle_deg), np.radians(sensor.beam_azimuth_deg)
    beams = np.array([(np.sin(angle) * np.cos(a), np.sin(angle) * np.sin(a), np.cos(angle)) for a in azimuths])
    flow = NS.inv().apply(CURRENT - V_NS)
    along = np.append(beams @ flow, flow[2])
    return {
        "distances": sensor.blanking_m + sensor.cell_size_m * np.arange(1, sensor.cells + 1), "velocities_S": np.tile(flow, sensor.cells),
        "velocities_N": np.tile(CURRENT, sensor.cells), "error_velocities": np.zeros(sensor.cells),
        "beam_velocities": np.tile(along, sensor.cells), "v_S": NS.inv().apply(V_NS), "altitude": (BOTTOM - P_NS[2]) / AXIS[2],
        "beam_ranges": (BOTTOM - P_NS[2]) / NS.apply(beams)[:, 2],
    }  # fmt: skip


def ranges(sensor):
    half = np.radians(sensor.field_of_view_deg) / 2.0
    angles = np.linspace(-half, half, sensor.beams)
    rays = NS.apply(np.stack([np.cos(angles), np.sin(angles), np.zeros(sensor.beams)], axis=1))
    reach = (WALL - P_NS[0]) / rays[:, 0]
    return {"ranges": [r if r <= sensor.max_range_m else None for r in reach]}


def profiler(sensor):
    """The first beam of its sector."""
    angle = -0.5 * np.radians(sensor.sector_width_deg)
    return {"head_angle": angle, "max_range": sensor.range_m, "frequency": sensor.frequency_hz, "sound_speed": C}


ALONE = {
    "imu": lambda _: {"f_S": NS.inv().apply(NB.apply(ACCELERATION) - (0.0, 0.0, G)), "w_S": BS.inv().apply(W), "temperature": 12.0},
    "pressure": lambda _: {"pressure": ATMOSPHERE + DENSITY * G * P_NS[2], "temperature": 12.0},
    "motion_capture": lambda _: {"p_NS": P_NS, "q_NS": np.roll(NS.as_quat(), 1)},
    "dvl": dvl,
    "adcp": adcp,
    "altimeter": lambda _: {"range": BOTTOM - P_NS[2], "confidence": 1.0},
    "scanning_sonar": lambda sensor: {"head_angle": 0.0, "range": sensor.range_m, "gain": sensor.gain_db},
    "multibeam": lambda sensor: {
        "range_start": 0.0, "range": sensor.range_m, "gain": sensor.gain_db, "frequency": sensor.frequency_hz, "sound_speed": C,
    },
    "side_scan": lambda sensor: {
        "range": sensor.range_m, "gain": sensor.gain_db, "frequency": sensor.frequency_hz, "sound_speed": C,
    },
    "bathymetry": lambda sensor: {
        "max_range": sensor.range_m, "gain": 0.0, "frequency": sensor.frequency_hz, "sound_speed": C,
    },
    "profiler": profiler,
    "usbl": usbl,
    "lbl": lbl,
    "magnetometer": lambda _: {"field_S": NS.inv().apply(MAGNETIC)},
    "attitude": lambda _: {"q_NS": np.roll(NS.as_quat(), 1), "heading": NS.as_euler("ZYX")[0]},
    "ctd": lambda _: {"temperature": 12.0, "pressure": ATMOSPHERE + DENSITY * G * P_NS[2], "salinity": WATER.salinity_at(P_NS[2])},
    "sound_speed": lambda _: {"sound_speed": C},
    "range_array": ranges,
    "clock": lambda _: {"utc_ns": 1_767_225_602_500_000_000, "elapsed": 2.5},
}  # fmt: skip
"""Truth of a sensor that stands alone, by its configuration."""
BEACON = Beacon(position_ned_m=(-5.0, -30.0, float(P_NS[2])))  # as deep as the device: so the sound speed is one
CHANGES = {
    "pressure": {"output": "pressure"},
    "dvl": {"range_modes": ()},  # it would begin with the shortest
    "adcp": {"cells": 10},  # all of them above the bottom
    "usbl": {"beacons": {"b": BEACON}, "propagation": "straight"},
    "lbl": {"beacons": {"b": BEACON}, "propagation": "straight"},
    "range_array": {"max_range_m": 30.0},
}
"""So that the first reading is one."""


def last(world, name, field):
    slot = world.sensors[f"heavy/{name}"]
    return slot.held[1][[f.name for f in slot.fields].index(field)]


def gps(world):
    q, p = world.vehicles["heavy"].q_NB, world.vehicles["heavy"].p_NB
    sensor = world.sensors["heavy/gps"].sensor
    dry = Scope(0, (p[0], p[1], -4.0), q, (1.0, 0.0, 0.5), (0.0, 0.0, 0.0), world.water, earth=world.earth)
    valid, (latitude, longitude, height, v, *_) = measured(sensor, dry)
    p_NA = np.array(dry.position((0.0, 0.0, -0.2)))
    assert valid
    assert (latitude, longitude) == pytest.approx(world.earth.geodetic(tuple(p_NA))[:2], abs=1e-9)
    assert height == pytest.approx(-p_NA[2], abs=1e-9)
    body = Rotation.from_quat([*q[1:], q[0]])
    assert v == pytest.approx(body.apply((1.0, 0.0, 0.5)), abs=1e-9)


def battery(world):
    voltage, current, power = (last(world, "battery", name) for name in ("voltage", "current", "power"))
    sensor = world.sensors["heavy/battery"].sensor
    electromotive = sensor_rig.electromotive(sensor._config, sensor.memory.charge / sensor._capacity)
    # The charge went down by this reading's own current after its voltage was found.
    assert voltage == pytest.approx(electromotive - sensor._config.resistance_ohm * current, abs=1e-3)
    assert power == pytest.approx(voltage * current, rel=1e-9)
    assert voltage == pytest.approx(world.sensors["heavy/battery"].wiring.voltage, abs=1e-9)


def rpm(world):
    row = world.hydro.thrusters[0]
    lag = world.hydro.lags[int(row["lag"])]
    force = float(lag["C"] @ row["x"] + lag["D"] * row["demand"]) / float(row["installed"])
    electric = world.sensors["heavy/shafts"].wiring.electrics["t1"]
    assert force != 0.0
    expected = (math.copysign(electric.speed[force < 0.0] * math.sqrt(abs(force)), force), 0.0)
    assert last(world, "shafts", "speeds") == pytest.approx(expected, abs=1e-9)


def contact(world):
    assert (last(world, "bumper", "touching"), last(world, "bumper", "count")) == (False, 0)


def leak(world):
    sensor = world.sensors["heavy/leak"].sensor
    assert last(world, "leak", "leak") is (sensor.memory.volume >= sensor._threshold) is True


def compound(world):
    assert last(world, "navigation", "imu_f_S") == last(world, "imu", "f_S")
    assert not world.sensors["heavy/navigation"].held[0]  # for one of its members, the GPS, is under water
    assert last(world, "navigation", "gps_valid") is False
    assert last(world, "navigation", "compass_field_S") == last(world, "compass", "field_S")


def acoustic_modem(world):
    begin, away = world.t_ns, math.dist(world.vehicles["small"].p_NB, world.vehicles["heavy"].p_NB)
    world.command("small/modem/send", destination=1, data=b"hello")
    world.step(240)
    assert [last(world, "modem/received", name) for name in ("event", "source", "destination")] == ["data", 2, 1]
    assert last(world, "modem/received", "data").data == b"hello"
    taken = (world.sensors["heavy/modem/received"].held_ns - begin) * 1e-9
    assert taken == pytest.approx(
        away / world.water.sound_speed(5.0), abs=1e-3
    )  # both move, and the modems are not in the middle


def optical_modem(world):
    sensor = world.sensors["heavy/light/received"].sensor
    there = sensor.crossing(
        SCOPE, sensor.signal((1.0, 0.0, 0.0, 0.0)), (0.0, 0.0, 5.0), (3.0, 0.0, 5.0), (0.0, 0.0, 0.0, 1.0), 0.0
    )
    assert there.time == pytest.approx(3.0 * 1.34 / 2.998e8)
    assert there.towards == pytest.approx((-1.0, 0.0, 0.0), abs=1e-9)


def training(world):
    """Under power near the surface: the first of one task runs."""
    assert [last(world, "training", name) for name in ("state", "task", "number", "count")] == ["running", "dive", 1, 3]
    assert last(world, "training", "distance") == pytest.approx(abs(4.0 - world.vehicles["heavy"].p_NB[2]), abs=0.05)


def camera(world):
    """Depth of a level bottom: of each pixel that does not see the pile."""
    slot = world.sensors["heavy/ranger"]
    lens, pose = slot.sensor._config.optics(), slot.sensor._mount
    for sample in (s for _ in range(60) for s in world.step() if s.port == "heavy/ranger"):
        depth = sample.value[0].array().astype(float)
    x = world.hydro.state[world.vehicles["heavy"].row]
    NS = Rotation.from_quat([*x[4:7], x[3]]) * Rotation.from_quat([*pose.q[1:], pose.q[0]])
    p = x[:3] + Rotation.from_quat([*x[4:7], x[3]]).apply(pose.p)
    rays = lens.table()
    down = NS.apply(rays)[:, 2]
    expected = np.where(down > 0.0, 1e3 * (40.0 - p[2]) / np.where(down > 0.0, down, 1.0) * rays[:, 0], 0.0)
    expected[expected >= 65535.5] = 0.0
    right = np.abs(depth.ravel() - expected) <= 0.02 * expected + 1.0  # the vehicle has moved since
    assert right.mean() > 0.8
    assert (expected > 0.0).mean() > 0.05


IN_A_WORLD = {
    "gps": gps, "battery": battery, "rpm": rpm, "contact": contact, "leak": leak, "compound": compound, "acoustic_modem": acoustic_modem,
    "optical_modem": optical_modem, "camera": camera, "training": training,
}  # fmt: skip


def test_no_kind_is_forgotten():
    """What is not in these tables is tried in a test of its own, which bears the name of its file."""
    own = {path.stem.removeprefix("test_") for path in Path(__file__).parent.glob("*/test_*.py")}
    others = {kind for kind, table in kinds_of(SensorConfig).items() if table.__module__.rpartition(".")[2] in own}
    assert ALONE.keys() | IN_A_WORLD.keys() | others == set(KINDS)
    assert BLIND.keys() | NEVER_BLIND.keys() | {"compound", "acoustic_modem", "optical_modem"} | others == set(KINDS)
    assert SETTINGS.keys() | PLAIN | others == set(KINDS)


@pytest.mark.parametrize("kind", ALONE)
def test_ideal_is_the_truth(kind, shipped):
    sensor = structs.replace(perfect(shipped[kind]), **CHANGES.get(kind, {}))
    built = sensor.build(MOUNT)
    reading = measured(built, SCOPE)
    assert reading[0]
    values = {field.name: value for field, value in zip(built.fields, reading[1], strict=True)}
    for name, expected in ALONE[kind](sensor).items():
        found, expected = values[name], expected.tolist() if hasattr(expected, "tolist") else expected
        if name == "q_NS" and np.dot(found, expected) < 0.0:
            expected = [-c for c in expected]
        assert found == pytest.approx(tuple(expected) if isinstance(expected, list) else expected, abs=1e-9), name


@pytest.mark.parametrize("kind", IN_A_WORLD)
def test_ideal_is_the_truth_in_a_world(kind, world):
    IN_A_WORLD[kind](world)


# -- valid ------------------------------------------------------------------------------------------------------------------------------

AIR = replace(SCOPE, p_NB=(3.0, -2.0, -5.0))
BLIND = {
    "motion_capture": AIR, "dvl": AIR, "adcp": AIR, "altimeter": AIR, "scanning_sonar": AIR, "multibeam": AIR, "side_scan": AIR,
    "bathymetry": AIR, "profiler": AIR,
    "usbl": AIR, "lbl": AIR, "ctd": AIR, "sound_speed": AIR,
    "range_array": AIR, "gps": SCOPE, "attitude": replace(SCOPE, t_ns=0), "rpm": SCOPE, "camera": SCOPE,
    "pressure": replace(SCOPE, water=replace(WATER, gravity=0.0)),
}  # fmt: skip
"""An instant at which it cannot measure: in air, under water, while it settles, unwired, without weight."""
NEVER_BLIND = {
    "imu": "feels always", "magnetometer": "feels always", "contact": "nothing touched is an answer", "battery": "empty is an answer",
    "leak": "dry is an answer", "training": "sees the truth", "clock": "goes on",
}  # fmt: skip


@pytest.mark.parametrize("kind", BLIND)
def test_it_says_when_it_cannot_measure(kind, shipped):
    sensor = structs.replace(shipped[kind], **({"settling_s": 5.0} if kind == "attitude" else {}))
    if kind == "pressure":
        sensor = structs.replace(sensor, output="depth")
    valid, values = measured(sensor.build(MOUNT), BLIND[kind])
    assert not valid
    parts = [part for value in values for part in (value if isinstance(value, tuple) else (value,))]
    assert None in parts


@pytest.mark.parametrize("kind", NEVER_BLIND)
def test_it_can_always_measure(kind, shipped):
    for scope in (SCOPE, AIR, replace(SCOPE, p_NB=(0.0, 0.0, 6000.0))):
        assert measured(shipped[kind].build(MOUNT), scope)[0]


# -- settings ---------------------------------------------------------------------------------------------------------------------------

SETTINGS = {
    "dvl": {"max_altitude": 20.0, "range_mode": 1, "tracking": "bottom", "sound_speed": 1480.0},
    "adcp": {"cell_size": 0.5, "blanking": 0.3, "pings": 4, "sound_speed": 1480.0},
    "altimeter": {"range": 12.0, "gain": -6.0, "sound_speed": 1480.0},
    "scanning_sonar": {"range": 8.0, "gain": 3.0, "step": 0.1, "sector_center": 0.5, "sector_width": 1.0},
    "multibeam": {"range": 8.0, "gain": 3.0},
    "side_scan": {"range": 8.0, "gain": 3.0},
    "bathymetry": {"range": 8.0, "gain": 3.0},
    "profiler": {"range": 8.0, "gain": 3.0, "step": 0.1, "sector_center": 0.5, "sector_width": 1.0},
    "usbl": {"max_range": 300.0, "gain": -3.0, "sound_speed": 1480.0},
    "lbl": {"max_range": 300.0, "gain": -3.0, "sound_speed": 1480.0},
    "acoustic_modem": {"address": 7, "gain": -3.0, "sound_speed": 1480.0},
    "optical_modem": {"address": 7, "gain": -3.0, "sound_speed": 1480.0},
    "range_array": {"max_range_m": 3.0},
    "gps": {"satellites": 6},
    "battery": {"hotel_load_W": 50.0},
    "leak": {"area_m2": 1e-5},
    "training": {"running": False, "mark": True},
    "camera": {"exposure": 0.005, "gain": 6.0, "auto_exposure": True},
}  # fmt: skip
"""What can be set of the device besides its rate: range and gain where it has them."""
PLAIN = {
    "imu",
    "pressure",
    "motion_capture",
    "magnetometer",
    "attitude",
    "ctd",
    "sound_speed",
    "contact",
    "rpm",
    "clock",
    "compound",
}


@pytest.mark.parametrize("kind", [*SETTINGS, *sorted(PLAIN)])
def test_what_can_be_set(kind, world):
    path = next(path for path, port in world.ports.items() if port.kind == kind and path.startswith("heavy/"))
    service = world.services[f"{path}/set"]
    wanted = SETTINGS.get(kind, {})
    assert {argument.name for argument in service.arguments} == {"rate_hz", *wanted}
    before = world.call(f"{path}/get")
    for name, value in wanted.items():
        assert before[name] != value
    world.call(f"{path}/set", rate_hz=4.0, **wanted)
    after = world.call(f"{path}/get")
    assert {name: after[name] for name in wanted} == wanted
    assert after["rate_hz"] == world.ports[path].rate_hz == 4.0
    for argument in service.arguments:
        if argument.minimum is not None:
            with pytest.raises(Refused):
                world.call(f"{path}/set", **{"rate_hz": 4.0, argument.name: argument.minimum - 1.0})
    assert world.call(f"{path}/get") == after
    world.call(f"{path}/set", rate_hz=before["rate_hz"], **{name: before[name] for name in wanted})
    assert world.call(f"{path}/get") == before
