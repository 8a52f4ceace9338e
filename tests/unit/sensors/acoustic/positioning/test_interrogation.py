"""Asking beacons: motion of both sides, what hides a beacon or is too weak, multipath, fading, and the time at which an answer arrives."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from sensor_rig import (
    BEACONS,
    CUBE,
    LBL,
    PLACES,
    RANGE,
    USBL,
    Carrier,
    answers,
    exchange,
    first,
    moving,
)

from uwserver.frames import quat_from_rpy
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import LblConfig, Pose, UsblConfig
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane, Sphere
from uwserver.world.state import snapshot


def test_contract(scope):
    state = {"t_ns": 10**9, "v_NB_B": (1.0, 0.0, 0.0)}
    instants = [
        scope(p_NB=p, q_NB=quat_from_rpy(0.1, -0.2, yaw), **state)
        for p in ((1, 2, 5.0), (0, 0, -3.0), (1e6, 0, 9e3))
        for yaw in (0, 3)
    ]
    for config in (
        LBL,
        USBL,
        LblConfig(rate_hz=10, beacons=BEACONS),
        UsblConfig(rate_hz=10, beacons=BEACONS, hydrophones_m=CUBE),
    ):
        check_sensor(config, instants=instants)


def test_beacons_move_with_vehicles_and_ships(scope):
    beacons = {
        "ship": Beacon(position_ned_m=(100.0, 0.0, 2.0), velocity_ned_mps=(0.0, 1.5, 0.0)),
        "rov": Beacon(vehicle="rov", position_frd_m=(1.0, 0.0, 0.0)),
        "lost": Beacon(vehicle="nobody"),
    }
    config = LblConfig(rate_hz=10, ideal=True, beacons=beacons)
    instant = scope(p_NB=(0.0, 0.0, 5.0), t_ns=20 * 10**9)
    instant.vehicles = {"rov": Carrier((40.0, 30.0, 5.0), quat_from_rpy(0.0, 0.0, math.pi / 2))}
    ship, rov, lost = answers(config, instant, 3)
    # The ship is heard, and answers, where it is when the question gets there.
    heard = 30.0 + 1.5 * 0.5 * ship.values[2]
    assert ship.values[RANGE] == pytest.approx(math.dist((100.0, heard, 2.0), (0.0, 0.0, 5.0)), abs=1e-6)
    assert rov.values[RANGE] == pytest.approx(math.dist((40.0, 31.0, 5.0), (0.0, 0.0, 5.0)), abs=1e-9)
    assert (lost.valid, lost.values) == (False, ["lost", None, None])


def test_multipath_is_late_never_early(scope):
    config = LblConfig(rate_hz=10, beacons={"a": BEACONS["a"]}, multipath_probability=0.2, source_level_db=230.0)
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    error = np.array([r.values[RANGE] for r in answers(config, instant, 1500)]) - math.dist(PLACES["a"], (0, 0, 20.0))
    image = math.hypot(120.0, 40.0, 80.0) - math.hypot(120.0, 40.0, 40.0)
    late = error > 1.0
    assert late.mean() == pytest.approx(0.2, abs=0.05)
    assert error[late] == pytest.approx(np.full(late.sum(), image), abs=0.1)
    assert np.abs(error[~late]).max() < 0.1


def test_what_stands_between_hides_a_beacon(scope):
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    middle = tuple(0.5 * (a + b) for a, b in zip(PLACES["a"], (0.0, 0.0, 20.0), strict=True))
    aside = (middle[0], middle[1], middle[2] - 9.0)
    bottom = Plane((0.0, 0.0, 60.2), (0.0, 0.0, -1.0))
    for shape, seen in ((Sphere(middle, 2.0), False), (Sphere(aside, 2.0), True), (bottom, True)):
        instant.geometry = FakeGeometry([shape])
        assert answers(LBL, instant, 1)[0].valid is seen
    # The hull that carries the beacon does not hide it.
    instant.geometry = FakeGeometry([Sphere(PLACES["a"], 0.4)])
    assert answers(LBL, instant, 1)[0].valid


def test_lost_when_too_far_too_weak_or_out_of_the_water(scope):
    deep = scope(p_NB=(0.0, 0.0, 20.0))
    assert not answers(LblConfig(rate_hz=10, ideal=True, beacons=BEACONS, max_range_m=100.0), deep, 1)[0].valid
    assert not answers(LblConfig(rate_hz=10, beacons=BEACONS, source_level_db=130.0), deep, 1)[0].valid
    assert not answers(LBL, scope(p_NB=(0.0, 0.0, -1.0)), 1)[0].valid
    floating = LblConfig(rate_hz=10, ideal=True, beacons={"a": Beacon(position_ned_m=(10.0, 0.0, -1.0))})
    assert not answers(floating, deep, 1)[0].valid


def test_fading_loses_half_at_the_threshold(scope):
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    d, alpha = math.dist(PLACES["a"], (0, 0, 20.0)), instant.water.absorption(26e3, 20.0)
    at_threshold = 10.0 + 20.0 * math.log10(d) + alpha * d + 50.0 + 10.0 * math.log10(4e3)
    config = LblConfig(rate_hz=10, beacons={"a": BEACONS["a"]}, source_level_db=at_threshold, fading_sigma_db=3.0)
    assert np.mean([r.valid for r in answers(config, instant, 2000)]) == pytest.approx(0.5, abs=0.04)


@pytest.mark.parametrize("speed", [-3.0, 0.0, 3.0])
@pytest.mark.parametrize("turn_around", [0.0, 0.3])
def test_a_moving_vehicle_hears_the_answer_where_it_is_by_then(scope, speed, turn_around):
    """Towards a beacon at distance d: there in d / c, and back in (d - v (d / c + turn-around)) / (c + v)."""
    d = 700.0
    beacon = Beacon(position_ned_m=(d, 0.0, 20.0), turn_around_s=turn_around)
    config = LblConfig(rate_hz=10, beacons={"a": beacon}, ideal=True, propagation="straight")
    reading = first(config.build(Pose()), moving(scope, (0.0, 0.0, 20.0), (speed, 0.0, 0.0)))
    c = scope().water.sound_speed(20.0)
    back = (d - speed * (d / c + turn_around)) / (c + speed)
    assert reading.values[2] == pytest.approx(d / c + back, abs=1e-11)
    assert reading.values[RANGE] == pytest.approx(0.5 * c * (d / c + back), abs=1e-8)
    assert reading.delay_ns == pytest.approx(1e9 * (d / c + turn_around + back), abs=1)
    assert reading.since_ns - 1e9 / 240 < reading.delay_ns <= reading.since_ns


def test_a_moving_beacon_is_asked_where_it_is_by_then(scope):
    """Across: c^2 t^2 = d^2 + v^2 t^2 there, and back from where it is after its turn-around."""
    d, v, turn_around = 600.0, 5.0, 0.25
    c = scope().water.sound_speed(20.0)
    there = d / math.sqrt(c * c - v * v)
    back = math.hypot(d, v * (there + turn_around)) / c
    device = LblConfig(
        rate_hz=10, beacons={"a": Beacon(vehicle="rov", turn_around_s=turn_around)}, ideal=True, propagation="straight"
    ).build(Pose())

    def instants():
        for k, instant in enumerate(moving(scope, (0.0, 0.0, 20.0), (0.0, 0.0, 0.0))):
            instant.vehicles = {"rov": Carrier((d, v * k / 240, 20.0), nu=(0.0, v, 0.0, 0.0, 0.0, 0.0))}
            yield instant

    assert first(device, instants()).values[2] == pytest.approx(there + back, abs=1e-11)


def test_a_snapshot_amid_an_exchange_goes_on_alike():
    lbl = LblConfig(rate_hz=10, beacons={"a": Beacon(position_ned_m=(900.0, 0.0, 30.0))})
    entry = VehicleEntry(model="bluerov2", position_ned_m=(0.0, 0.0, 30.0), sensors={"lbl": lbl})
    world = build(load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}))
    world.step(300)
    kept = snapshot.take(world)
    once = [s.value for s in world.step(480) if s.port == "rov/lbl"]
    snapshot.restore(world, kept)
    assert [s.value for s in world.step(480) if s.port == "rov/lbl"] == once
    assert once


def test_sound_that_came_while_the_device_was_silent_is_missed(scope):
    device = LblConfig(rate_hz=10, beacons={"a": BEACONS["a"]}, ideal=True).build(Pose())
    ticks = list(itertools.islice(moving(scope, (0.0, 0.0, 5.0), (0.0, 0.0, 0.0)), 1200))
    reading = first(device, [*ticks[:2], *ticks[-2:]])
    assert not reading.valid


def test_delivered_when_the_sound_arrives(scope):
    """There, turn-around, and back; the next question waits for it; without answer for as long as one could come."""
    device = LblConfig(rate_hz=240, ideal=True, beacons=BEACONS, max_range_m=200.0, processing_s=0.05).build(Pose())
    told = {}
    for k in range(480):
        reading = device.sense(scope(p_NB=(0.0, 0.0, 5.0), t_ns=round(k * 1e9 / 240)))
        if reading is not None:
            told[k - round(reading.since_ns * 240e-9)] = reading
            # Told at the first tick after the arrival, to be delivered after the processing.
            if reading.valid:
                assert reading.since_ns - 1e9 / 240 < reading.delay_ns - 0.05e9 <= reading.since_ns
    (k0, first), (k1, second), (k2, third), *_ = told.items()
    assert first.delay_ns == pytest.approx(1e9 * (first.values[2] + 0.1 + 0.05), abs=2)
    c = scope().water.sound_speed(5.0)
    assert not third.valid
    assert third.delay_ns == pytest.approx(1e9 * (400.0 / c + 0.1 + 0.05), abs=2)
    for early, late, reading in ((k0, k1, first), (k1, k2, second)):
        assert late - early == math.ceil(reading.delay_ns / 1e9 * 240)


def test_faults_of_beacons():
    with pytest.raises(ValueError, match="exactly one of"):
        Beacon()
    with pytest.raises(ValueError, match="on one line"):
        UsblConfig(rate_hz=1, beacons=BEACONS, hydrophones_m=((0, 0, 0), (1, 0, 0), (2, 0, 0)))
    sensor = LblConfig(rate_hz=1, beacons={"x": Beacon(vehicle="rvo")})
    with pytest.raises(ScenarioError, match=r'no vehicle "rvo" \(did you mean "rov"\?\)'):
        load(Scenario(schema=1, vehicles={"rov": VehicleEntry(model="bluerov2", sensors={"lbl": sensor})}), adapters={})


def test_settings(scope):
    device = LblConfig(rate_hz=10, beacons=BEACONS).build(Pose())
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    assert exchange(device, instant)[0]
    device.change({"gain": -60.0})
    assert not exchange(device, instant)[0]
    assert device.properties() == {"max_range": 1000.0, "gain": -60.0, "sound_speed": 0.0}
