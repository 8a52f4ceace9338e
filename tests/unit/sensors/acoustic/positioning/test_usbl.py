"""USBL: the truth when ideal, bearing errors against theory, sound through layers, and the moment that it tells of."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensor_rig import (
    BEACONS,
    BEARING,
    CUBE,
    EACH,
    ELEVATION,
    MOUNT,
    P_S,
    PLACES,
    RANGE,
    TILTED,
    TIME,
    USBL,
    answers,
    first,
    layered,
    moving,
)

from uwserver.environment.acoustics.channel import channel_of
from uwserver.frames import conjugate, rotate
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import Pose, UsblConfig
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.units import rad


def test_ideal_usbl_is_the_truth(scope):
    instant = scope(**TILTED)
    _, v = USBL.build(MOUNT).measure(instant)
    p = rotate(conjugate(instant.attitude(MOUNT.q)), np.subtract(PLACES["a"], instant.position(MOUNT.p)))
    assert v[RANGE] == pytest.approx(math.hypot(*p), abs=1e-9)
    assert v[P_S] == pytest.approx(p, abs=1e-9)
    assert v[BEARING] == pytest.approx(math.atan2(p[1], p[0]), abs=1e-9)
    assert v[ELEVATION] == pytest.approx(math.atan2(p[2], math.hypot(p[0], p[1])), abs=1e-9)
    for place, each in zip(USBL.hydrophones_m, v[EACH], strict=True):  # the paper's form
        assert each == pytest.approx(math.dist(p, place), abs=1e-9)


def test_usbl_sees_the_beacon_where_its_sound_comes_from(scope):
    instant = layered(scope)
    beacon = {"a": Beacon(position_ned_m=(300.0, 400.0, 150.0))}
    config = UsblConfig(rate_hz=10, beacons=beacon, hydrophones_m=CUBE, source_level_db=260.0)
    dip = channel_of(instant.water.column, 26e3).paths(500.0, 5.0, 150.0)[0].dip_a
    elevation = answers(config, instant, 1)[0].values[ELEVATION]
    assert elevation == pytest.approx(dip, abs=1e-4)
    assert abs(dip - math.atan2(145.0, 500.0)) > 0.005


@pytest.mark.parametrize(("n", "rel"), [(700, 0.135), pytest.param(6000, 0.05, marks=pytest.mark.slow)])
@pytest.mark.parametrize("off_axis", [0.0, 30.0, 60.0])
def test_bearing_error_of_theory(scope, off_axis, n, rel):
    """sigma = c sigma_phi / (2 pi f d cos theta) along the line of two hydrophones d apart, sigma_phi = 1 / sqrt snr."""
    place = (200.0 * math.sin(rad(off_axis)), 0.0, 5.0 + 200.0 * math.cos(rad(off_axis)))
    config = UsblConfig(rate_hz=10, beacons={"a": Beacon(position_ned_m=place)}, propagation="straight")
    instant = scope(p_NB=(0.0, 0.0, 5.0))
    readings = answers(config, instant, n, 1)
    along = np.array([math.atan2(v.values[P_S][0], v.values[P_S][2]) for v in readings])
    c, alpha = instant.water.sound_speed(5.0), instant.water.absorption(26e3, 5.0)
    snr = 10.0 ** (0.1 * (185.0 - 20.0 * math.log10(200.0) - alpha * 200.0 - 50.0 - 10.0 * math.log10(4e3)))
    theory = c / math.sqrt(snr) / (2.0 * math.pi * 26e3 * 0.03 * math.cos(rad(off_axis)))
    assert along.std() == pytest.approx(theory, rel=rel)
    assert along.mean() == pytest.approx(rad(off_axis), abs=5.0 * theory / math.sqrt(n) + 1e-4)


def test_a_misaligned_array_turns_the_bearing(scope):
    config = UsblConfig(
        rate_hz=10, beacons={"a": BEACONS["a"]}, source_level_db=260.0, misalignment_rpy_deg=(0.0, 0.0, 2.0)
    )
    bearing = answers(config, scope(p_NB=(0.0, 0.0, 5.0)), 1)[0].values[BEARING]
    assert bearing == pytest.approx(math.atan2(40.0, 120.0) - rad(2.0), abs=2e-3)


def test_usbl_takes_the_direction_when_the_answer_arrives(scope):
    """A vehicle that turns sees the beacon where it is at the arrival, not a tick later."""
    w, d = 0.7, 400.0
    config = UsblConfig(rate_hz=10, beacons={"a": Beacon(position_ned_m=(d, 0.0, 20.0))}, ideal=True)
    reading = first(config.build(Pose()), moving(scope, (0.0, 0.0, 20.0), (0.0, 0.0, 0.0), (0.0, 0.0, w)))
    assert reading.values[BEARING] == pytest.approx(-w * reading.values[TIME], abs=1e-9)


def test_in_a_world_a_sample_arrives_later_than_it_was_true():
    """A ship tracks a vehicle by USBL: path, loader and delivery."""
    ship = UsblConfig(rate_hz=4, ideal=True, beacons={"rov": Beacon(vehicle="rov")})
    entries = {
        "ship": VehicleEntry(model="bluerov2", position_ned_m=(0.0, 0.0, 2.0), sensors={"usbl": ship}),
        "rov": VehicleEntry(model="bluerov2", position_ned_m=(300.0, 400.0, 52.0)),
    }
    world = build(load(Scenario(schema=1, vehicles=entries), adapters={}))
    samples = [s for s in world.step(480) if s.port == "ship/usbl"]
    assert len(samples) >= 2
    for sample in samples:
        travel = (sample.t_sent_ns - sample.t_ns) / 1e9
        assert travel == pytest.approx(2 * 502.5 / 1490.0, rel=0.02)
        assert sample.value[RANGE] == pytest.approx(502.5, abs=2.0)
