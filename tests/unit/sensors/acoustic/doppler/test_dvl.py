"""The DVL against closed forms over planes, its errors against theory, and what makes it lose lock."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.environment.acoustics.boundaries import lambert
from uwserver.frames import quat_from_rpy, rotate
from uwserver.ports import Refused
from uwserver.sensors import DvlConfig, Pose
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane, Sphere
from uwserver.units import rad

DOWN = Plane((0.0, 0.0, 30.0), (0.0, 0.0, -1.0))
IDEAL = DvlConfig(rate_hz=8, ideal=True)
V_S, ALTITUDE, FOM, COVARIANCE, SPEEDS, RANGES, LOCKS, V_WATER = range(8)


@pytest.fixture
def over(scope):
    """`over(plane, **state)`: an instant above something."""

    def build(*shapes, materials=(), **state):
        made = scope(**state)
        made.geometry = FakeGeometry(shapes or (DOWN,), materials)
        return made

    return build


def ping(config, instant, mount=None, seed=0):
    dvl = config.build(mount or Pose())
    dvl.start(seed)
    return dvl.sense(instant)


def test_contract():
    check_sensor(IDEAL)
    check_sensor(DvlConfig(rate_hz=8, scale_sigma=0.01, false_echo_probability=0.1))


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.1, -0.15, 2.0), (-0.2, 0.05, -1.0)])
@pytest.mark.parametrize("mount", [Pose(), Pose((0.4, -0.2, 0.3), quat_from_rpy(0.1, 0.05, 0.8))])
def test_ideal_is_the_truth(over, rpy, mount):
    """Velocity with lever arm, ranges and the distance along the axis, at any tilt over a slope."""
    v, w, q = (0.7, -0.4, 0.2), (0.1, -0.2, 0.3), quat_from_rpy(*rpy)
    slope = Plane((0.0, 0.0, 20.0), (0.1, -0.05, -1.0))
    instant = over(slope, v_NB_B=v, w_NB_B=w, q_NB=q, p_NB=(1.0, 2.0, 5.0))
    reading = ping(IDEAL, instant, mount)
    assert reading.valid
    to_S = tuple(-x for x in mount.q[1:])
    v_S = rotate((mount.q[0], *to_S), np.add(v, np.cross(w, mount.p)))
    assert reading.values[V_S] == pytest.approx(v_S, abs=1e-9)
    assert reading.values[LOCKS] == (True,) * 4
    normal = np.array(slope.normal) / np.linalg.norm(slope.normal)
    p_NS = np.array(instant.position(mount.p))
    height = -(p_NS - slope.point) @ normal / (rotate(instant.attitude(mount.q), (0.0, 0.0, 1.0)) @ normal)
    assert reading.values[ALTITUDE] == pytest.approx(height, abs=1e-9)
    for azimuth, speed, reach in zip((45, 135, 225, 315), reading.values[SPEEDS], reading.values[RANGES], strict=True):
        u = np.array(
            [
                math.sin(rad(22.5)) * math.cos(rad(azimuth)),
                math.sin(rad(22.5)) * math.sin(rad(azimuth)),
                math.cos(rad(22.5)),
            ]
        )
        d = rotate(instant.attitude(mount.q), u)
        assert speed == pytest.approx(u @ v_S, abs=1e-9)
        assert reach == pytest.approx(-(p_NS - slope.point) @ normal / (d @ normal), abs=1e-9)


def test_ideal_water_track_is_the_truth(over):
    reading = ping(IDEAL, over(v_NB_B=(0.5, 0.1, -0.1), q_NB=quat_from_rpy(0.0, 0.0, math.pi / 2)))
    assert reading.values[V_WATER] == pytest.approx(
        (0.5, 0.1 + 0.3, -0.1), abs=1e-9
    )  # the current of 0.3 m/s to the north comes from starboard


def spread(config, instant, n, seed):
    """(n, 3) velocities."""
    dvl = config.build(Pose())
    dvl.start(seed)
    return np.array([dvl.sense(instant).values[V_S] for _ in range(n)])


FEW = 2000, 0.08
MANY = pytest.param(20_000, 0.03, marks=pytest.mark.slow)
"""Pings, and five standard errors of their spread or more."""


@pytest.mark.parametrize(("n", "rel"), [FEW, MANY])
@pytest.mark.parametrize(("angle", "sigma"), [(25.0, 0.005), (22.5, 0.01), (30.0, 0.0022)])
def test_noise_is_that_of_theory(over, angle, sigma, n, rel):
    """sigma_xy = sigma_b / (sqrt 2 sin theta), sigma_z = sigma_b / (2 cos theta), and the device says so itself."""
    config = DvlConfig(rate_hz=8, beam_angle_deg=angle, beam_sigma_mps=sigma, max_altitude_m=500.0, tracking="bottom")
    instant = over(v_NB_B=(1.0, -0.5, 0.2))
    v = spread(config, instant, n, 1)
    expected = np.array([sigma / (math.sqrt(2) * math.sin(rad(angle)))] * 2 + [sigma / (2 * math.cos(rad(angle)))])
    assert v.std(axis=0) == pytest.approx(expected, rel=rel)
    assert v.mean(axis=0) == pytest.approx((1.0, -0.5, 0.2), abs=5 * expected.max() / math.sqrt(len(v)))
    reading = ping(config, instant)
    assert np.diag(np.reshape(reading.values[COVARIANCE], (3, 3))) == pytest.approx(expected**2)
    assert reading.values[FOM] == pytest.approx(math.sqrt(sum(expected**2)))


@pytest.mark.parametrize(("n", "rel"), [FEW, MANY])
def test_noise_of_three_beams(over, n, rel):
    """Three beams in lock: the covariance that the device tells is that of its velocities."""
    wall = Plane((-3.0, 0.0, 0.0), (1.0, 0.0, 0.0))  # behind the two aft beams, seen at grazing incidence
    config = DvlConfig(rate_hz=8, beam_azimuth_deg=(0.0, 120.0, 240.0), max_altitude_m=500.0, tracking="bottom")
    instant = over(DOWN, wall)
    v = spread(config, instant, n, 4)
    told = np.reshape(ping(config, instant).values[COVARIANCE], (3, 3))
    assert v.std(axis=0) == pytest.approx(np.sqrt(np.diag(told)), rel=rel)


def test_a_wrong_sound_speed_stretches_velocity_and_range(over):
    quiet = DvlConfig(rate_hz=8, beam_sigma_mps=0, range_sigma_m=0, assumed_sound_speed_mps=1500)
    instant = over(v_NB_B=(1.0, -0.5, 0.2))
    stretch = 1500 / instant.water.sound_speed(5.0)
    reading = ping(quiet, instant)
    assert abs(stretch - 1) > 0.002
    assert reading.values[V_S] == pytest.approx(np.multiply(stretch, (1.0, -0.5, 0.2)), rel=1e-9)
    assert reading.values[ALTITUDE] == pytest.approx(25.0 * stretch, rel=1e-9)


def test_scale_error_is_drawn_once_a_run(over):
    config = DvlConfig(rate_hz=8, beam_sigma_mps=0, scale_error=0.001, scale_sigma=0.003)
    instant = over(v_NB_B=(2.0, 0.0, 0.0))
    scales = []
    for seed in range(400):
        v = spread(config, instant, 2, seed)[:, 0]
        assert v[0] == v[1]
        scales.append(v[0] / 2.0 - 1.0)
    assert np.mean(scales) == pytest.approx(0.001, abs=5e-4)
    assert np.std(scales) == pytest.approx(0.003, rel=0.1)


def test_misalignment_turns_the_velocity(over):
    config = DvlConfig(rate_hz=8, beam_sigma_mps=0, misalignment_rpy_deg=(0.0, 0.0, 1.0))
    v = ping(config, over(v_NB_B=(1.0, 0.0, 0.0))).values[V_S]
    assert v == pytest.approx((math.cos(rad(1.0)), -math.sin(rad(1.0)), 0.0), abs=1e-12)


def test_a_beam_loses_lock_beyond_its_range_alone(over):
    """Rolled until two beams reach no bottom: no solution, and the sample says so."""
    config = DvlConfig(rate_hz=8, ideal=True, max_altitude_m=28.0)
    assert ping(config, over()).valid
    reading = ping(config, over(q_NB=quat_from_rpy(0.5, 0.0, 0.0)))
    assert sum(reading.values[LOCKS]) == 2
    assert not reading.valid
    assert reading.values[V_S] == (None,) * 3
    assert reading.values[SPEEDS].count(None) == 2


def test_three_beams_are_enough(over):
    ball = Sphere((1.0 + 10 * math.sin(rad(22.5)), 2.0, 5.0 + 10.0), 0.3)
    config = DvlConfig(rate_hz=8, ideal=True, beam_azimuth_deg=(0.0, 90.0, 180.0, 270.0), min_altitude_m=20.0)
    reading = ping(config, over(DOWN, ball, v_NB_B=(0.3, 0.2, 0.1)))
    assert reading.values[LOCKS].count(False) == 1
    assert reading.values[V_S] == pytest.approx((0.3, 0.2, 0.1), abs=1e-9)


def test_soft_mud_and_steep_slopes_lose_lock(over):
    """At 0.9 of its range the device holds on sediment and rock, and neither on mud nor on a slope."""
    deep = {"p_NB": (0.0, 0.0, 5.0)}
    near_limit = Plane((0.0, 0.0, 50.0), (0.0, 0.0, -1.0))
    config = DvlConfig(rate_hz=8)
    table = lambert(["sediment", "mud", "rock"])

    def locks(material, plane=near_limit):
        instant = over(plane, materials=(material,), **deep)
        instant.lambert = table
        return ping(config, instant).values[LOCKS]

    assert locks(0) == (True,) * 4
    assert locks(2) == (True,) * 4
    assert locks(1) == (False,) * 4
    assert False in locks(0, Plane((0.0, 0.0, 50.0), (0.7, 0.0, -1.0)))


def test_too_fast_and_out_of_the_water(over):
    assert not ping(DvlConfig(rate_hz=8, ideal=True, max_speed_mps=1.0), over(v_NB_B=(9.0, 0.0, 0.0))).valid
    assert not ping(IDEAL, over(p_NB=(0.0, 0.0, -0.5))).valid


def test_upside_down_it_sees_the_moving_surface(over):
    """The surface is a function, not a mesh; it moves with the water."""
    instant = over(q_NB=quat_from_rpy(math.pi, 0.0, 0.0), v_NB_B=(1.0, 0.0, 0.0), p_NB=(0.0, 0.0, 8.0))
    reading = ping(IDEAL, instant)
    assert reading.values[ALTITUDE] == pytest.approx(8.0, abs=1e-9)
    assert reading.values[V_S] == pytest.approx((1.0 - 0.3, 0.0, 0.0), abs=1e-9)


def test_water_track_needs_room(over):
    config = DvlConfig(rate_hz=8, ideal=True, water_far_m=4.5)
    assert None not in ping(config, over(Plane((0, 0, 12.0), (0, 0, -1.0)))).values[V_WATER]
    assert None in ping(config, over(Plane((0, 0, 9.0), (0, 0, -1.0)))).values[V_WATER]


def test_delivered_when_the_echo_is_there(over):
    reading = ping(DvlConfig(rate_hz=8, processing_s=0.02), over())
    c = over().water.sound_speed(5.0)
    assert reading.delay_ns == pytest.approx(1e9 * (2 * 25.0 / math.cos(rad(22.5)) / c + 0.02), abs=2)


def test_range_modes_set_the_rate(over):
    """The device pings as the mode of its altitude allows, and searches the modes for a lost bottom."""
    modes = ((0.05, 3.0, 10.0), (1.5, 14.0, 5.0), (10.0, 50.0, 2.0))
    dvl = DvlConfig(rate_hz=20, ideal=True, range_modes=modes).build(Pose())
    found = {}
    for depth, expected in ((2.0, 10.0), (8.0, 5.0), (25.0, 2.0)):
        plane = Plane((0.0, 0.0, 5.0 + depth), (0.0, 0.0, -1.0))
        dvl.start(0)
        readings = [dvl.sense(over(plane, t_ns=k * 50_000_000)) for k in range(240)]
        found[expected] = sum(r is not None and r.valid for r in readings[40:]) / 10.0
    assert found == pytest.approx({10.0: 10.0, 5.0: 5.0, 2.0: 2.0})


def test_settings(over):
    dvl = DvlConfig(rate_hz=8, ideal=True, range_modes=((0.05, 60.0, 5.0),)).build(Pose())
    dvl.change({"max_altitude": 20.0, "tracking": "bottom"})
    assert dvl.properties() == {"max_altitude": 20.0, "range_mode": -1, "tracking": "bottom", "sound_speed": 0.0}
    reading = dvl.sense(over())
    assert not reading.valid
    assert reading.values[V_WATER] == (None,) * 3
    with pytest.raises(Refused, match="range modes"):
        dvl.change({"range_mode": 1})
    assert dvl.settings.range_mode == -1


def test_false_echoes_come_as_often_as_told(over):
    config = DvlConfig(rate_hz=8, false_echo_probability=0.05, beam_sigma_mps=0, range_sigma_m=0)
    dvl = config.build(Pose())
    r = 25.0 / math.cos(rad(22.5))
    instant = over()
    seen = np.array([dvl.sense(instant).values[RANGES] for _ in range(1000)])
    assert np.mean(seen < r - 1e-6) == pytest.approx(0.05, abs=0.018)
