"""The IMU on an Earth that turns: against Newton's laws among the stars, gyrocompassing, and a vehicle that stays neutral everywhere."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_rig import started

import uwserver
from uwserver.environment.earth import (
    EARTH_RATE,
    ECCENTRICITY_SQUARED,
    GRAVITY_GROWTH,
    SEMI_MAJOR_AXIS,
    Earth,
    normal_gravity,
)
from uwserver.frames import quat_from_rpy
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.sensors import ImuConfig, Pose
from uwserver.sensors.motion.triad import HUMP, TriadErrors
from uwserver.units import rad

TURN = np.array([0.0, 0.0, EARTH_RATE])
"""rad/s, in Earth-centred axes, z to the north pole."""


def placed(latitude_deg: float, *, rate_hz: float = 240.0, **world: object) -> ScenarioBuilder:
    return ScenarioBuilder("somewhere", rate_hz=rate_hz).world(
        origin_lat_deg=latitude_deg, origin_lon_deg=25.0, **world
    )


# -- at rest ----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("latitude_deg", [-70.0, -10.0, 0.0, 52.0])
def test_at_rest_and_level_it_feels_the_earth_turn(scope, latitude_deg):
    latitude = rad(latitude_deg)
    _, (f_S, w_S, _) = (
        ImuConfig(rate_hz=100)
        .build(Pose())
        .measure(scope(earth=Earth(latitude, 0.4, rotating=True), p_NB=(0.0, 0.0, 0.0)))
    )
    assert w_S == pytest.approx((EARTH_RATE * math.cos(latitude), 0.0, -EARTH_RATE * math.sin(latitude)), abs=1e-18)
    assert f_S == pytest.approx((0.0, 0.0, -9.81), abs=1e-15)


def test_what_plain_python_says_is_what_compiled_code_reads(scope):
    moving = scope(
        earth=Earth(0.9, 0.4, rotating=True), p_NB=(5e3, -7e3, 40.0), q_NB=quat_from_rpy(0.3, -0.4, 2.0), v_NB_B=(2.0, -1.0, 0.5),
        w_NB_B=(0.1, 0.2, -0.3), nu_dot=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
    )  # fmt: skip
    moving.water.growth = 1e-4
    mount = Pose((0.3, -0.2, 0.5), quat_from_rpy(1, 2, 3))
    _, (f_S, _, _) = ImuConfig(rate_hz=100).build(mount).measure(moving)
    assert f_S == pytest.approx(moving.specific_force(mount), abs=1e-13)


# -- against Newton's laws --------------------------------------------------------------------------------------------------------------


def ellipsoid(latitude: float, longitude: float, depth: float) -> np.ndarray:
    """Earth-centred place, m."""
    across = SEMI_MAJOR_AXIS / math.sqrt(1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    flat, around = across - depth, math.cos(latitude)
    polar = (1.0 - ECCENTRICITY_SQUARED) * across - depth
    return np.array(
        [flat * around * math.cos(longitude), flat * around * math.sin(longitude), polar * math.sin(latitude)]
    )


def level(latitude: float, longitude: float) -> np.ndarray:
    """Columns: north, east and down in Earth-centred axes."""
    s, c, sl, cl = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    return np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])


def coordinates(r: np.ndarray) -> tuple[float, float, float]:
    """Latitude, longitude and depth of an Earth-centred place: a few rounds towards the point of the ellipsoid above it."""
    across, latitude = math.hypot(r[0], r[1]), math.atan2(r[2], math.hypot(r[0], r[1]))
    for _ in range(4):
        radius = SEMI_MAJOR_AXIS / math.sqrt(1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
        depth = radius - across / math.cos(latitude)
        latitude = math.atan2(r[2], across * (1.0 - ECCENTRICITY_SQUARED * radius / (radius - depth)))
    return latitude, math.atan2(r[1], r[0]), depth


def navigated(samples: list, start: tuple, v: np.ndarray, q: tuple, dt: float) -> tuple[float, float, float]:
    """Where an ideal IMU's readings lead, by Newton's laws in axes that do not turn, and the gravitation that goes with `normal_gravity`.

    start: latitude, longitude (rad) and depth (m); v: over ground in N, m/s; q: attitude in N.
    """
    r, axes = ellipsoid(*start), level(start[0], start[1])
    velocity = axes @ v + np.cross(TURN, r)
    attitude = Rotation.from_matrix(axes) * Rotation.from_quat([*q[1:], q[0]])

    def gravitation(r: np.ndarray, t: float) -> np.ndarray:
        spin = Rotation.from_rotvec(TURN * t)
        at = spin.inv().apply(r)
        latitude, longitude, depth = coordinates(at)
        g = normal_gravity(latitude) * (1.0 + GRAVITY_GROWTH * max(0.0, depth)) * level(latitude, longitude)[:, 2]
        return spin.apply(g + np.cross(TURN, np.cross(TURN, at)))

    for k, (one, two) in enumerate(itertools.pairwise(samples)):
        turned = attitude * Rotation.from_rotvec(0.5 * dt * (np.array(one[1]) + np.array(two[1])))
        force = 0.5 * (attitude.apply(one[0]) + turned.apply(two[0]))
        middle = r + 0.5 * dt * velocity
        faster = velocity + dt * (force + gravitation(middle, (k + 0.5) * dt))
        r, velocity, attitude = r + 0.5 * dt * (velocity + faster), faster, turned
    return coordinates(Rotation.from_rotvec(-TURN * (len(samples) - 1) * dt).apply(r))


@pytest.mark.parametrize(("latitude_deg", "seconds"), [(-35.0, 30), pytest.param(62.0, 60, marks=pytest.mark.slow)])
def test_its_readings_lead_to_where_the_vehicle_is(latitude_deg, seconds):
    """On a slow turn at 1.5 m/s. In a minute, without the Earth's rate it would be off by 18 m, without Coriolis' term by 0.4 m, without the
    transport rate by 8 cm.

    The navigation knows nothing of N, of levels or of rates of axes.
    """
    b = placed(latitude_deg)
    b.vehicle(
        "rov", "bluerov2_heavy", position_ned_m=[300.0, -200.0, 150.0], attitude_rpy_deg=[0, 0, 40], velocity_frd_mps=[1.5, 0.1, 0.0],
        truth={"rate_hz": 240},
    )  # fmt: skip
    b.sensor("rov", "imu", "imu", rate_hz=240, ideal=True)
    world = uwserver.load(b.build()).core
    world.command("rov/thrusters", u=[0.4, 0.42, -0.4, -0.4, 0.0, 0.0, 0.0, 0.0])
    world.step(720)  # its first pitch is too quick for the trapezium rule
    seen: dict[str, list] = {"rov/imu": [], "rov/truth/pose": [], "rov/truth/velocity": []}
    for _ in range(seconds):
        world.command("rov/thrusters", u=[0.4, 0.42, -0.4, -0.4, 0.0, 0.0, 0.0, 0.0])
        for sample in world.step(240):
            if sample.port in seen:
                seen[sample.port].append(sample.value)
    poses, velocities = seen["rov/truth/pose"], seen["rov/truth/velocity"]
    earth = world.earth
    p, q = poses[0][:2]
    v = Rotation.from_quat([*q[1:], q[0]]).apply(velocities[0][0])
    # Away from the origin north of the map is not quite north of the place: the navigation begins there with the attitude of the place.
    latitude, longitude, height = earth.geodetic(tuple(p))
    convergence = (longitude - earth.longitude) * math.sin(0.5 * (latitude + earth.latitude))
    turn = Rotation.from_rotvec([0.0, 0.0, convergence])
    q_there = (turn * Rotation.from_quat([*q[1:], q[0]])).as_quat()
    found = navigated(
        seen["rov/imu"], (latitude, longitude, -height), turn.apply(v), (q_there[3], *q_there[:3]), 1 / 240
    )
    expected = earth.geodetic(tuple(poses[-1][0]))
    north = (found[0] - expected[0]) * 6.37e6
    east = (found[1] - expected[1]) * 6.37e6 * math.cos(expected[0])
    assert (north, east, found[2] + expected[2]) == pytest.approx((0.0, 0.0, 0.0), abs=0.01)


# -- north from the Earth's rate --------------------------------------------------------------------------------------------------------

MINUTES, RUNS, HEADING = 4.0, 40, rad(70.0)


def grade(errors: TriadErrors, latitude: float) -> float:
    """Standard deviation (rad) of the heading that a still gyroscope finds: of a rate across north over the Earth's rate to the north."""
    noise = errors.noise_density / math.sqrt(60.0 * MINUTES)
    vertical = errors.cross_axis * EARTH_RATE * math.sin(latitude)
    rate = math.hypot(errors.turn_on, errors.instability / HUMP, noise, vertical)
    return rate / (EARTH_RATE * math.cos(latitude))


@pytest.mark.parametrize(
    ("profile", "latitude_deg"),
    [
        ("fog_imu", -20.0),
        ("tactical_imu", 50.0),
        pytest.param("fog_imu", 50.0, marks=pytest.mark.slow),
        pytest.param("tactical_imu", -20.0, marks=pytest.mark.slow),
    ],
)
def test_a_still_unit_finds_north_as_well_as_its_grade_can(scope, profile, latitude_deg):
    b = placed(latitude_deg)
    b.vehicle("auv", "bluerov2_heavy").sensor("auv", "imu", "imu", rate_hz=0.5, profile=profile)
    resolved = load(b.build(), adapters={})
    config = resolved.vehicles["auv"].vehicle.sensors["imu"]
    latitude = rad(latitude_deg)
    still = scope(earth=Earth(latitude, 0.4, rotating=True), q_NB=quat_from_rpy(0.0, 0.0, HEADING))
    errors = []
    for seed in range(RUNS):
        device = started(config, seed, mount=Pose())
        w = np.mean([device.measure(still)[1][1] for _ in range(round(30 * MINUTES))], axis=0)
        errors.append(math.remainder(math.atan2(-w[1], w[0]) - HEADING, 2.0 * math.pi))
    assert math.sqrt(np.mean(np.square(errors))) == pytest.approx(grade(config.gyroscope, latitude), rel=0.3)


# -- weight and buoyancy ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("latitude_deg", [0.0, 45.0, -80.0])
@pytest.mark.parametrize("depth", [5.0, 2000.0])
def test_what_is_neutral_stays_so_everywhere(latitude_deg, depth):
    """A ball as heavy as its water, and the accelerometer of one that lies still."""
    b = placed(latitude_deg)
    b.environment(density_kgpm3=1030.0)
    b.free_object("ball", "sphere", radius_m=0.5, density_kgpm3=1030.0, position_ned_m=[0, 0, depth])
    b.free_object("heavy", "sphere", radius_m=0.5, density_kgpm3=2060.0, position_ned_m=[9, 0, depth])
    b.vehicle("auv", "bluerov2_heavy", position_ned_m=[20, 0, depth])
    world = uwserver.load(b.build()).core
    g = normal_gravity(rad(latitude_deg)) * (1.0 + GRAVITY_GROWTH * depth)
    rows = {name: body.row for name, body in world.vehicles.items()}
    world.step(1)
    # Half its weight is carried, and half as much water as it weighs goes with it.
    assert world.hydro.state[rows["heavy"], 9] == pytest.approx(0.5 * g / 1.25 / 240, rel=1e-4)
    world.step(240 * 20)
    assert np.abs(world.hydro.state[rows["ball"], 7:]).max() < 1e-12


def test_a_place_on_the_earth_gives_gravity_and_turns():
    def environment(**world):
        b = placed(60.0, **world)
        return load(b.build(), adapters={}).scenario.environment

    assert environment().gravity == normal_gravity(rad(60.0))
    assert environment().growth == GRAVITY_GROWTH
    assert environment(earth="flat").gravity == normal_gravity(rad(60.0))
    assert environment(earth="flat").growth == 0.0
    given = load(placed(60.0).environment(gravity_mps2=9.7, gravity_growth_pm=0.0).build(), adapters={})
    assert (given.scenario.environment.gravity, given.scenario.environment.growth) == (9.7, 0.0)
    nowhere = load(ScenarioBuilder("nowhere").build(), adapters={}).scenario
    assert (nowhere.environment.gravity, nowhere.environment.growth, nowhere.world.rotating) == (9.81, 0.0, False)


def test_an_earth_that_turns_needs_a_place():
    with pytest.raises(ScenarioError, match='give origin_lat_deg and origin_lon_deg, or set earth = "flat"'):
        load(ScenarioBuilder("nowhere").world(earth="rotating").build(), adapters={})
    with pytest.raises(ScenarioError, match="give both or none"):
        load(ScenarioBuilder("nowhere").world(origin_lat_deg=3.0).build(), adapters={})
