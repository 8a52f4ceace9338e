"""Optical modems: a cone, a field of view, attenuation by the type of water, and bits told apart by light alone."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from modem_rig import counts, listen, modem, world_with

from uwserver.frames import quat_from_rpy
from uwserver.sensors import OpticalModemConfig, Pose

LEVEL = (1.0, 0.0, 0.0, 0.0)
BACK = quat_from_rpy(0.0, 0.0, math.pi)
KEYS = {
    "rate_hz": 1, "bits_per_s": 1e5, "max_range_m": 50.0, "wavelength_nm": 450.0, "power_w": 1.0, "beam_width_deg": 60.0, "aperture_m2": 1e-3,
    "view_width_deg": 60.0, "sensitivity_w": 1e-8, "protocol": "light", "max_bytes": 1000, "turn_around_s": 0.001,
}  # fmt: skip


def device(**keys):
    return OpticalModemConfig(**(KEYS | keys)).build(Pose())


def crossing(sensor, scope, distance, off=0.0, q=BACK):
    b = (distance * math.cos(off), distance * math.sin(off), 10.0)
    return sensor.crossing(scope, sensor.signal(LEVEL), (0.0, 0.0, 10.0), b, q, 0.0)


def test_light_fades_by_the_cone_and_the_water(scope):
    sensor, instant = device(), scope()
    found = crossing(sensor, instant, 10.0)
    spot = 2.0 * math.pi * (1.0 - math.cos(math.pi / 6)) * 100.0
    assert found.level_db == pytest.approx(10.0 * math.log10(1e-3 / spot * math.exp(-0.258 * 10.0)), abs=1e-9)
    murky = replace(instant, water=replace(instant.water, jerlov="7C"))
    assert found.level_db - crossing(sensor, murky, 10.0).level_db == pytest.approx(
        100.0 * (3.95 - 0.258) * math.log10(math.e)
    )
    assert found.time == pytest.approx(10.0 * 1.34 / 2.998e8)


def test_nothing_is_seen_out_of_the_cone_or_from_behind(scope):
    assert crossing(device(), scope(), 10.0, off=math.radians(29.0)) is not None
    assert crossing(device(), scope(), 10.0, off=math.radians(31.0)) is None
    assert crossing(device(), scope(), 10.0, q=LEVEL) is None


def test_one_bit_of_a_thousand_is_wrong_at_the_sensitivity():
    sensor = device()
    assert sensor.error_rate(3.0902**2, 1) == pytest.approx(1.0 - 0.999**8, rel=1e-3)
    assert sensor.error_rate(100.0**2, 1000) == 0.0


@pytest.mark.parametrize(
    ("wavelength", "attenuation"), [(450.0, 0.258), (540.0, 0.244), (495.0, 0.251), (400.0, 0.258), (700.0, 0.454)]
)
def test_attenuation_between_the_colours(scope, wavelength, attenuation):
    assert device(wavelength_nm=wavelength).attenuation(scope()) == pytest.approx(attenuation)


def test_two_vehicles_that_look_at_each_other_talk_and_none_hears_sound():
    places = {"a": (0.0, 0.0, 20.0), "b": (8.0, 0.0, 20.0), "c": (4.0, 3.0, 20.0)}
    ahead = OpticalModemConfig(**KEYS, address=1, position_frd_m=(0.5, 0.0, 0.0))
    behind = OpticalModemConfig(**KEYS, address=2, position_frd_m=(-0.5, 0.0, 0.0), rpy_deg=(0.0, 0.0, 180.0))
    world = world_with(places, {"a": ahead, "b": behind, "c": modem(3)})
    world.command("a/modem/send", destination=2, data=bytes(1000), acknowledge=1)
    world.command("c/modem/send", data=b"sound")
    told = listen(world, 1.0)
    assert [(m.by, m.event) for m in told] == [("b", "data"), ("a", "delivered")]
    assert told[0].t == pytest.approx(7.0 * 1.34 / 2.998e8, abs=1e-9)
    assert told[0].told == pytest.approx(told[0].t + 0.08, abs=1.0 / 240)
    assert counts(world, "c") == {"sent": 1}


def test_by_light_nobody_is_too_fast(scope):
    sensor = OpticalModemConfig(rate_hz=1).build(Pose())
    assert (sensor.fastest, sensor.speed_sigma) == (math.inf, None)
    found = sensor.crossing(
        scope(), sensor.signal((1.0, 0.0, 0.0, 0.0)), (0.0, 0.0, 5.0), (5.0, 0.0, 5.0), (0.0, 0.0, 0.0, 1.0), 0.0
    )
    assert found.leaves == pytest.approx((1.0, 0.0, 0.0))
