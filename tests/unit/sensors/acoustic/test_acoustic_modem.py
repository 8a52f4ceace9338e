"""Acoustic modems: levels by the sonar equation, noise, error rates in closed form, late arrivals, bands and directions."""

from __future__ import annotations

import math

import pytest
from modem_rig import modem
from sensor_rig import layered

from uwserver.sensors import Pose
from uwserver.sensors.modem import Signal

LEVEL = (1.0, 0.0, 0.0, 0.0)


def device(**keys):
    return modem(1, **keys).build(Pose())


def crossing(sensor, scope, a, b, gain=0.0):
    return sensor.crossing(scope, sensor.signal(LEVEL), a, b, LEVEL, gain)


def test_the_level_follows_the_sonar_equation(scope):
    sensor, instant = device(), scope(p_NB=(0.0, 0.0, 50.0))
    found = crossing(sensor, instant, (0.0, 0.0, 50.0), (1000.0, 0.0, 50.0), gain=-2.0)
    lost = 60.0 + 1000.0 * instant.water.absorption(26e3, 50.0)
    assert found.level_db == pytest.approx(185.0 - 2.0 - lost, abs=1e-3)
    assert 10.0 * math.log10(found.noise) == pytest.approx(40.0 + 10.0 * math.log10(4e3))
    assert found.time == pytest.approx(1000.0 / instant.water.sound_speed(50.0), rel=1e-6)
    sensor.change({"gain": -10.0})
    assert crossing(sensor, instant, (0.0, 0.0, 50.0), (1000.0, 0.0, 50.0)).level_db == pytest.approx(
        175.0 - lost, abs=1e-3
    )


def test_its_own_vehicle_is_heard_besides_the_sea(scope):
    quiet, loud = (device(noise_level_db=40.0, **keys) for keys in ({}, {"self_noise_db": 40.0}))
    assert loud.noise(scope()) == pytest.approx(2.0 * quiet.noise(scope()))


def test_noise_follows_frequency_where_none_is_given(scope):
    from msgspec import UNSET

    low, high = (device(noise_level_db=UNSET, frequency_hz=f).noise(scope()) for f in (10e3, 40e3))
    assert low > high


@pytest.mark.parametrize(
    ("modulation", "per_bit"),
    [("fsk", lambda x: 0.5 * math.exp(-0.5 * x)), ("psk", lambda x: 0.5 * math.erfc(math.sqrt(x)))],
)
def test_errors_follow_energy_per_bit(modulation, per_bit):
    sensor = device(modulation=modulation, bits_per_s=1000.0, coding_gain_db=3.0)
    for snr in (0.25, 1.0, 2.5):
        wrong = per_bit(snr * 4.0 * 10.0**0.3)
        assert sensor.error_rate(snr, 4) == pytest.approx(1.0 - (1.0 - wrong) ** 32, rel=1e-9)
    assert sensor.error_rate(1e6, 64) < 1e-300
    assert sensor.error_rate(1e-6, 64) == pytest.approx(1.0)


def test_only_what_is_later_than_the_guard_smears(scope):
    a, b = (0.0, 0.0, 20.0), (200.0, 0.0, 30.0)
    instant = layered(scope)
    free = crossing(device(propagation="layered", guard_s=1.0), instant, a, b)
    smeared = crossing(device(propagation="layered", guard_s=0.001), instant, a, b)
    assert free.late == 0.0
    assert 0.05 * smeared.signal < smeared.late < 2.0 * smeared.signal
    spread = crossing(device(propagation="layered", guard_s=0.001, multipath_rejection_db=20.0), instant, a, b)
    assert spread.late == pytest.approx(0.01 * smeared.late)


def test_it_takes_the_first_or_the_strongest(scope):
    instant, a, b = layered(scope), (0.0, 0.0, 20.0), (200.0, 0.0, 30.0)
    first, strongest = (
        crossing(device(propagation="layered", arrival=each), instant, a, b) for each in ("first", "strongest")
    )
    assert first.time < strongest.time - 1e-3
    # What comes within the guard adds to it.
    paths = sorted(device(propagation="layered")._link.paths(instant, b, a), key=lambda path: path.time)
    within = [path for path in paths if path.time - paths[0].time <= 0.01]
    assert len(within) > 1
    assert first.signal == pytest.approx(sum(10.0 ** (0.1 * (185.0 - path.loss)) for path in within))


def test_bands_overlap_by_part():
    sensor = device()
    for frequency, bandwidth, part in (
        (26e3, 4e3, 1.0),
        (28e3, 4e3, 0.5),
        (26e3, 8e3, 0.5),
        (40e3, 4e3, 0.0),
        (26e3, 1e3, 1.0),
    ):
        assert sensor.overlap(Signal("x", frequency, bandwidth, 185.0)) == pytest.approx(part)


def test_sound_comes_from_where_its_ray_does(scope):
    sensor = device(direction_sigma_deg=0.0)
    found = crossing(sensor, scope(), (30.0, 40.0, 90.0), (0.0, 0.0, 40.0))
    assert found.towards == pytest.approx(
        (30.0 / math.sqrt(5000), 40.0 / math.sqrt(5000), 50.0 / math.sqrt(5000)), abs=1e-6
    )
    bearing, elevation = sensor.direction(found.towards, LEVEL)
    assert (bearing, elevation) == pytest.approx((math.atan2(40, 30), math.pi / 4), abs=1e-6)
    assert device().direction(found.towards, LEVEL) is None


def test_sound_leaves_along_its_ray(scope):
    """Of a bent ray not where the other is: the same from both ends."""
    instant, a, b = layered(scope), (0.0, 0.0, 10.0), (1500.0, 0.0, 80.0)
    sensor = device(propagation="layered", noise_level_db=0.0)
    there, back = crossing(sensor, instant, a, b), crossing(sensor, instant, b, a)
    assert math.hypot(*there.leaves) == pytest.approx(1.0)
    assert there.leaves == pytest.approx(back.towards, abs=1e-6)
    assert there.towards == pytest.approx(back.leaves, abs=1e-6)
    straight = math.atan2(70.0, 1500.0)
    assert abs(math.asin(there.leaves[2]) - straight) > 1e-3
