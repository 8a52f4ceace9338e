"""The IMU in closed form: rest, tilt, spin, lever arm; and along a simulated motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_rig import (
    Q,
    at,
    started,
)

from uwserver.frames import quat_from_rpy
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import Current, Environment, WorldTable
from uwserver.sensors import (
    ImuConfig,
    Pose,
)
from uwserver.sensors.motion.triad import TriadErrors
from uwserver.sensors.truth import Truth
from uwserver.units import rad

G = 9.81
QUARTER = math.pi / 2


def measured(scope, mount=None):
    valid, (f_S, w_S, temperature) = ImuConfig(rate_hz=100).build(mount or Pose()).measure(scope)
    assert valid
    assert temperature == 12.0
    return f_S, w_S


def test_at_rest_and_level_it_feels_the_floor(scope):
    f_S, w_S = measured(scope())
    assert f_S == pytest.approx((0.0, 0.0, -G), abs=1e-15)
    assert w_S == pytest.approx((0.0, 0.0, 0.0), abs=1e-15)


@pytest.mark.parametrize(
    ("rpy", "f_S"),
    [
        ((QUARTER, 0, 0), (0, -G, 0)),  # starboard down: the floor pushes to port
        ((0, QUARTER, 0), (G, 0, 0)),  # bow up: it pushes the bow
        ((math.pi, 0, 0), (0, 0, G)),
        ((0, 0, 1.234), (0, 0, -G)),  # heading makes no difference
        ((0, rad(30), 0), (G * 0.5, 0, -G * math.sqrt(0.75))),
        ((rad(30), 0, 2.0), (0, -G * 0.5, -G * math.sqrt(0.75))),
    ],
)
def test_at_rest_and_tilted(scope, rpy, f_S):
    assert measured(scope(q_NB=quat_from_rpy(*rpy)))[0] == pytest.approx(f_S, abs=1e-14)


@pytest.mark.parametrize("rpy", [(0, 0, 0), (0.4, -0.3, 2.0)])
def test_in_free_fall_it_feels_nothing_wherever_it_sits(scope, rpy):
    q = quat_from_rpy(*rpy)
    x, y, z, w = q[1], q[2], q[3], q[0]
    g_B = Rotation.from_quat([x, y, z, w]).inv().apply([0, 0, G])
    f_S, _ = measured(scope(q_NB=q, nu_dot=(*g_B, 0, 0, 0)), Pose((0.3, -0.2, 0.5), quat_from_rpy(1, 2, 3)))
    assert f_S == pytest.approx((0, 0, 0), abs=1e-14)


def test_speed_and_current_alone_are_not_felt(scope):
    assert measured(scope(v_NB_B=(3.0, -2.0, 1.0)))[0] == pytest.approx((0, 0, -G), abs=1e-14)


def test_an_acceleration_is_felt(scope):
    assert measured(scope(nu_dot=(0.5, -0.25, 1.0, 0, 0, 0)))[0] == pytest.approx((0.5, -0.25, 1.0 - G))


def test_a_turning_circle_is_felt(scope):
    """Steady surge u and yaw rate r: the centripetal acceleration u r points to starboard."""
    assert measured(scope(v_NB_B=(2.0, 0, 0), w_NB_B=(0, 0, 0.5)))[0] == pytest.approx((0, 1.0, -G))


@pytest.mark.parametrize(
    ("w", "r", "centripetal"),
    [
        ((0, 0, 2.0), (0.5, 0, 0), (-2.0, 0, 0)),  # r w^2 towards the axis
        ((0, 0, 2.0), (0, 0.5, 0), (0, -2.0, 0)),
        ((0, 0, 2.0), (0, 0, 0.5), (0, 0, 0)),  # on the axis
        ((3.0, 0, 0), (0, 0, 0.1), (0, 0, -0.9)),
        ((0, -3.0, 0), (0.1, 0, 0), (-0.9, 0, 0)),
        ((1.0, 1.0, 0), (1.0, 0, 0), (-1.0, 1.0, 0)),  # w (w.r) - r w^2
    ],
)
def test_lever_arm_of_a_spin(scope, w, r, centripetal):
    f_S, w_S = measured(scope(w_NB_B=w), Pose(r))
    assert np.add(f_S, (0, 0, G)) == pytest.approx(np.array(centripetal), abs=1e-14)
    assert w_S == w


@pytest.mark.parametrize(
    ("w_dot", "r", "tangential"),
    [
        ((0, 0, 2.0), (0.5, 0, 0), (0, 1.0, 0)),
        ((0, 2.0, 0), (0.5, 0, 0), (0, 0, -1.0)),
        ((2.0, 0, 0), (0, 0.5, 0), (0, 0, 1.0)),
    ],
)
def test_lever_arm_of_a_beginning_spin(scope, w_dot, r, tangential):
    f_S, w_S = measured(scope(nu_dot=(0, 0, 0, *w_dot)), Pose(r))
    assert np.add(f_S, (0, 0, G)) == pytest.approx(np.array(tangential), abs=1e-14)
    assert w_S == (0, 0, 0)


@pytest.mark.parametrize(
    ("rpy", "f_S", "w_S"),
    [
        ((math.pi, 0, 0), (0.0, 0.0, G), (0.1, -0.2, -0.3)),  # upside down
        ((0, 0, QUARTER), (0.0, 0.0, -G), (0.2, -0.1, 0.3)),  # its x to starboard
        ((0, QUARTER, 0), (G, 0.0, 0.0), (-0.3, 0.2, 0.1)),  # its x up
        ((math.pi, 0, QUARTER), (0.0, 0.0, G), (0.2, 0.1, -0.3)),
    ],
)
def test_a_turned_mount_at_the_origin(scope, rpy, f_S, w_S):
    found = measured(scope(w_NB_B=(0.1, 0.2, 0.3)), Pose((0, 0, 0), quat_from_rpy(*rpy)))
    assert found[0] == pytest.approx(f_S, abs=1e-14)
    assert found[1] == pytest.approx(w_S, abs=1e-14)


# -- along a simulated motion -----------------------------------------------------------------------------------------------------------

MOUNT, TURN = (0.3, -0.2, 0.15), (20.0, -35.0, 110.0)


def moving_world(rate_hz: float):
    """A vehicle that spins and tumbles in a current, with an ideal IMU away from its origin."""
    entry = VehicleEntry(
        model="bluerov2_heavy",
        position_ned_m=(0.0, 0.0, 20.0),
        attitude_rpy_deg=(15.0, -10.0, 40.0),
        velocity_frd_mps=(0.8, -0.3, 0.2),
        angular_velocity_frd_degps=(40.0, -30.0, 60.0),
        truth=Truth(rate_hz=rate_hz),
        sensors={"x": ImuConfig(rate_hz=rate_hz, position_frd_m=MOUNT, rpy_deg=TURN)},
    )
    environment = Environment(current=Current(velocity_ned_mps=(0.4, 0.2, -0.1)))
    world = build(
        load(
            Scenario(schema=1, world=WorldTable(rate_hz=rate_hz), environment=environment, vehicles={"rov": entry}),
            adapters={},
        )
    )
    world.command("rov/thrusters", u=[0.3, 0.3, -0.2, -0.25, 0.4, 0.2, 0.1, 0.4])
    return world


def errors_against_the_trajectory(rate_hz: float) -> tuple[float, float]:
    """Largest difference of f_S to the twice differenced position of the mount, and of w_S to the differenced attitude, over half a second.

    The positions are of the truth port, so this knows nothing of the kernel's accelerations.
    """
    samples = moving_world(rate_hz).step(round(0.5 * rate_hz))
    pose = [s.value for s in samples if s.port == "rov/truth/pose"]
    imu = [s.value for s in samples if s.port == "rov/x"]
    p = np.array([value[0] for value in pose])
    body = Rotation.from_quat(np.array([value[1] for value in pose])[:, [1, 2, 3, 0]])
    sensor = body * Rotation.from_euler("ZYX", TURN[::-1], degrees=True)
    track = p + body.apply(MOUNT)
    a_N = (track[2:] - 2 * track[1:-1] + track[:-2]) * rate_hz**2
    f_S = sensor[1:-1].inv().apply(a_N - [0, 0, G])
    w_S = (sensor[:-2].inv() * sensor[2:]).as_rotvec() * rate_hz / 2
    # The thrusters' first steps are left out: a command is a kink that no difference can follow.
    skip = round(0.1 * rate_hz)
    f_error = np.abs(np.array([value[0] for value in imu])[1:-1] - f_S)[skip:].max()
    w_error = np.abs(np.array([value[1] for value in imu])[1:-1] - w_S)[skip:].max()
    return f_error, w_error


def test_agrees_with_the_trajectory_to_second_order():
    """Halving the step quarters the difference: what is left is the differencing, not the sensor."""
    coarse, fine = errors_against_the_trajectory(240.0), errors_against_the_trajectory(480.0)
    assert fine[0] < 0.01
    assert fine[1] < 0.005
    for c, f in zip(coarse, fine, strict=True):
        assert 3.3 < c / f < 4.8


def test_ideal_imu_equals_truth():
    samples = moving_world(240.0).step(48)
    by_port = {s.port: s.value for s in samples if s.t_ns == samples[-1].t_ns}
    q = by_port["rov/truth/pose"][1]
    v, w = map(np.array, by_port["rov/truth/velocity"])
    v_dot, w_dot = map(np.array, by_port["rov/truth/acceleration"])
    r = np.array(MOUNT)
    body = Rotation.from_quat([*q[1:], q[0]])
    a_B = v_dot + np.cross(w, v) + np.cross(w_dot, r) + np.cross(w, np.cross(w, r)) - body.inv().apply([0, 0, G])
    turn = Rotation.from_euler("ZYX", TURN[::-1], degrees=True).inv()
    assert np.array(by_port["rov/x"][0]) == pytest.approx(turn.apply(a_B), abs=1e-9)
    assert np.array(by_port["rov/x"][1]) == pytest.approx(turn.apply(w), abs=1e-9)


def test_an_ideal_imu_is_exact_whatever_the_profile(scope):
    errors = TriadErrors(noise_density=1.0, turn_on=1.0, scale=0.5, instability=1.0)
    instant = at(scope, 0.0, q_NB=Q, w_NB_B=(0.1, 0.2, 0.3))
    ideal = started(ImuConfig(rate_hz=100, ideal=True, gyroscope=errors, accelerometer=errors)).sense(instant)
    assert ideal.values == started(ImuConfig(rate_hz=100)).sense(instant).values
