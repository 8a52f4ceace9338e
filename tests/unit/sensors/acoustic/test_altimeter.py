"""The echosounder: the nearest point in its cone, and what noise, blanking, multiples and loss make of it. Also of uwserver.sensors.acoustic.echo."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.environment.acoustics.boundaries import lambert
from uwserver.frames import quat_from_rpy
from uwserver.sensors import AltimeterConfig, Pose
from uwserver.sensors.acoustic.altimeter import AltimeterMemory
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane, Sphere
from uwserver.units import rad

BOTTOM = Plane((0.0, 0.0, 25.0), (0.0, 0.0, -1.0))
IDEAL = AltimeterConfig(rate_hz=10, ideal=True, beam_width_deg=30.0)


@pytest.fixture
def over(scope):
    """`over(shape, ..., **state)`: an instant 5 m deep above a bottom in 25 m, or something else."""

    def build(*shapes, materials=(), **state):
        made = scope(**state)
        made.geometry = FakeGeometry(shapes or (BOTTOM,), materials)
        return made

    return build


def ping(config, instant, mount=None, seed=0):
    altimeter = config.build(mount or Pose())
    altimeter.start(seed)
    return altimeter.sense(instant)


def many(config, instant, n, seed=0):
    """Readings of n pings, one after the other has ended."""
    altimeter = config.build(Pose())
    altimeter.start(seed)
    readings = []
    for _ in range(n):
        altimeter.memory = AltimeterMemory()
        readings.append(altimeter.sense(instant))
    return readings


def test_contract():
    check_sensor(IDEAL)
    check_sensor(AltimeterConfig(rate_hz=10, multiple_probability=0.1))


@pytest.mark.parametrize("pitch", [0.0, 5.0, 14.9, 15.1, 40.0, 60.0])
@pytest.mark.parametrize("roll", [0.0, -8.0])
def test_ideal_is_the_nearest_point_in_the_cone(over, roll, pitch):
    """Straight down while that lies in the cone, else along its edge: closed form for a plane."""
    q = quat_from_rpy(rad(roll), rad(pitch), 0.7)
    tilt = math.acos(math.cos(rad(roll)) * math.cos(rad(pitch)))
    valid, (reach, confidence) = IDEAL.build(Pose()).measure(over(q_NB=q))
    assert valid
    assert confidence == 1.0
    assert reach == pytest.approx(20.0 / math.cos(max(0.0, tilt - rad(15.0))), abs=1e-9)


def test_ideal_from_a_mount(over):
    mount = Pose((0.5, 0.0, 0.2), quat_from_rpy(0.0, rad(10.0), 0.0))
    assert ping(IDEAL, over(), mount).values[0] == pytest.approx(19.8, abs=1e-9)


def test_the_first_echo_is_the_nearest(over):
    """A ball within the cone comes before the bottom; outside of it it does not."""
    ball = Sphere((1.0, 2.0, 20.0), 1.0)
    assert ping(IDEAL, over(BOTTOM, ball)).values[0] == pytest.approx(14.0, abs=1e-9)
    aside = Sphere((9.0, 2.0, 20.0), 1.0)
    assert ping(IDEAL, over(BOTTOM, aside)).values[0] == pytest.approx(20.0, abs=1e-9)


def test_a_small_thing_is_too_weak(over):
    """One ray of sixty-one brings too little for the threshold at long range: the bottom is told."""
    config = AltimeterConfig(rate_hz=10, beam_width_deg=30.0, max_range_m=25.0, range_sigma_m=0)
    pebble = Sphere((1.0, 2.0, 20.0), 0.4)
    ranges = [r.values[0] for r in many(config, over(BOTTOM, pebble), 50) if r.valid]
    assert np.median(ranges) == pytest.approx(20.0, abs=0.1)


def test_looking_up_it_sees_the_surface(over):
    q = quat_from_rpy(math.pi, rad(4.0), 0.0)
    assert ping(IDEAL, over(q_NB=q)).values[0] == pytest.approx(5.0, abs=1e-9)


@pytest.mark.parametrize(("n", "rel"), [(1500, 0.09), pytest.param(9000, 0.04, marks=pytest.mark.slow)])
def test_noise(over, n, rel):
    config = AltimeterConfig(rate_hz=10, range_sigma_m=0.03, range_sigma_relative=0.002)
    r = np.array([reading.values[0] for reading in many(config, over(), n, 1) if reading.valid])
    sigma = math.hypot(0.03, 0.002 * 20.0)
    assert r.std() == pytest.approx(sigma, rel=rel)
    assert r.mean() == pytest.approx(20.0, abs=5 * sigma / math.sqrt(len(r)))


def test_a_wrong_sound_speed_stretches_the_range(over):
    config = AltimeterConfig(rate_hz=10, range_sigma_m=0, assumed_sound_speed_mps=1500.0)
    instant = over()
    assert ping(config, instant).values[0] == pytest.approx(20.0 * 1500.0 / instant.water.sound_speed(5.0), rel=1e-9)


def test_half_of_the_echoes_are_found_at_full_range(over):
    """Of sediment at normal incidence; near it all, and with confidence; on rock more, on mud none."""
    config = AltimeterConfig(rate_hz=10, beam_width_deg=1.0)
    far = Plane((0.0, 0.0, 54.999), (0.0, 0.0, -1.0))

    def found(material, plane=far, n=300):
        instant = over(plane, materials=(material,))
        instant.lambert = lambert(["sediment", "mud", "rock"])
        readings = many(config, instant, n)
        return np.mean([r.valid for r in readings]), np.mean([r.values[1] or 0.0 for r in readings])

    assert found(0, n=2000)[0] == pytest.approx(0.5, abs=0.06)
    assert found(1)[0] < 0.02
    assert found(2)[0] > 0.98
    assert found(0, Plane((0.0, 0.0, 10.0), (0.0, 0.0, -1.0))) == (1.0, pytest.approx(1.0, abs=0.01))
    assert found(0, Plane((0.0, 0.0, 50.0), (0.0, 0.0, -1.0)))[1] < 0.4


def test_lost_out_of_range_and_out_of_the_water(over):
    config = AltimeterConfig(rate_hz=10, max_range_m=15.0)
    for instant in (over(), over(p_NB=(0.0, 0.0, -1.0))):
        reading = ping(config, instant)
        assert (reading.valid, reading.values) == (False, [None, None])


@pytest.mark.parametrize(("height", "told"), [(0.5, 0.5), (0.25, 0.5), (0.12, 0.36), (0.08, 0.32)])
def test_within_the_blanking_it_hears_a_multiple(over, height, told):
    config = AltimeterConfig(rate_hz=10, range_sigma_m=0)
    reading = ping(config, over(Plane((0.0, 0.0, 5.0 + height), (0.0, 0.0, -1.0))))
    assert reading.values[0] == pytest.approx(told, abs=1e-9)
    ideal = ping(AltimeterConfig(rate_hz=10, ideal=True), over(Plane((0.0, 0.0, 5.0 + height), (0.0, 0.0, -1.0))))
    assert ideal.valid == (height >= 0.3)


def test_second_echoes_come_as_often_as_told(over):
    config = AltimeterConfig(rate_hz=10, range_sigma_m=0, multiple_probability=0.1, multiple_loss_db=3)
    r = np.array([reading.values[0] or 0.0 for reading in many(config, over(), 1500)])
    assert np.mean(np.isclose(r, 40.0)) == pytest.approx(0.1, abs=0.04)
    assert np.mean(np.isclose(r, 20.0)) == pytest.approx(0.9, abs=0.04)


def test_timing(over):
    """Delivered when the echo is there; the next ping waits until the sound could be back from the end of the range."""
    c = over().water.sound_speed(5.0)
    altimeter = AltimeterConfig(rate_hz=100, processing_s=0.005, max_range_m=30.0).build(Pose())
    readings = [altimeter.sense(over(t_ns=k * 10_000_000)) for k in range(100)]
    told = [r for r in readings if r is not None]
    assert told[0].delay_ns == round(1e9 * (2 * 20.0 / c + 0.005))
    assert len(told) == 20  # 60 m / c is 40.4 ms: every fifth of the ticks


def test_settings(over):
    altimeter = AltimeterConfig(rate_hz=10).build(Pose())
    altimeter.change({"range": 10.0})
    assert not altimeter.sense(over()).valid
    altimeter = AltimeterConfig(rate_hz=10).build(Pose())
    altimeter.change({"gain": -40.0})
    assert not altimeter.sense(over()).valid
    assert altimeter.properties() == {"range": 50.0, "gain": -40.0, "sound_speed": 0.0}


def test_a_shorter_range_pings_faster_and_hears_no_worse(over):
    near = AltimeterConfig(rate_hz=100, range_m=25.0)
    rates = []
    for config in (near, AltimeterConfig(rate_hz=100)):
        altimeter = config.build(Pose())
        readings = [altimeter.sense(over(t_ns=k * 10_000_000)) for k in range(100)]
        told = [r for r in readings if r is not None]
        rates.append(len(told))
        assert all(r.valid for r in told)
    assert rates == [25, 15]
    with pytest.raises(ValueError, match=r"range_m is .*, the (sonar|altimeter) takes"):
        AltimeterConfig(rate_hz=10, range_m=60.0)
