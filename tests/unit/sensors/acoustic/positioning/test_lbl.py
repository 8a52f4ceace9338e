"""LBL: the truth when ideal, range errors against theory, sound through layers, and the way that the sound went."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensor_rig import (
    BEACONS,
    LBL,
    MOUNT,
    NAME,
    PLACES,
    RANGE,
    TILTED,
    answers,
    exchange,
    layered,
)

from uwserver.environment.acoustics.channel import channel_of
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import LblConfig
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.sensors.truth import Truth


def test_ideal_lbl_is_the_truth_in_turn(scope):
    instant = scope(**TILTED)
    device = LBL.build(MOUNT)
    for name in ("a", "b", "c", "a"):
        valid, values = exchange(device, instant)
        d = math.dist(PLACES[name], instant.position(MOUNT.p))
        assert valid
        assert values[NAME] == name
        assert values[RANGE] == pytest.approx(d, abs=1e-9)
        assert values[2] == pytest.approx(2.0 * d / instant.water.sound_speed(30.0), rel=1e-3)


def test_travel_time_through_the_layers(scope):
    """That of the eigenray; the believed sound speed makes a range of it; straight lines take longer."""
    instant = layered(scope)
    beacon = {"a": Beacon(position_ned_m=(300.0, 400.0, 150.0))}
    bent, lines = (
        answers(LblConfig(rate_hz=10, ideal=True, beacons=beacon, propagation=p), instant, 1)[0]
        for p in ("layered", "straight")
    )
    ray = channel_of(instant.water.column, 26e3).paths(500.0, 5.0, 150.0)[0]
    assert bent.values[2] == pytest.approx(2.0 * ray.time, rel=1e-12)
    assert bent.values[2] < lines.values[2]
    noisy = LblConfig(rate_hz=10, beacons=beacon, assumed_sound_speed_mps=1500.0, source_level_db=250.0)
    reading = answers(noisy, instant, 1)[0]
    assert reading.values[RANGE] == pytest.approx(750.0 * bent.values[2], abs=1e-3)


@pytest.mark.parametrize(("n", "rel"), [(1500, 0.09), pytest.param(9000, 0.04, marks=pytest.mark.slow)])
def test_range_jitter_follows_the_signal(scope, n, rel):
    """1 / (B sqrt snr) for each way."""
    config = LblConfig(rate_hz=10, beacons={"a": BEACONS["a"]}, max_range_m=5000.0)
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    r = np.array([reading.values[RANGE] for reading in answers(config, instant, n, 1)])
    c, alpha, d = (
        instant.water.sound_speed(20.0),
        instant.water.absorption(26e3, 20.0),
        math.dist(PLACES["a"], (0, 0, 20.0)),
    )
    snr = 10.0 ** (0.1 * (185.0 - 20.0 * math.log10(d) - alpha * d - 50.0 - 10.0 * math.log10(4e3)))
    assert r.std() == pytest.approx(c / (math.sqrt(2.0) * 4e3 * math.sqrt(snr)), rel=rel)
    assert r.mean() == pytest.approx(d, abs=0.03)


def test_in_a_world_the_range_is_that_of_the_way_it_went():
    """A vehicle that coasts: the range follows from the ground truth at the question and at the arrival."""
    lbl = LblConfig(
        rate_hz=10, ideal=True, propagation="straight", beacons={"a": Beacon(position_ned_m=(900.0, 0.0, 30.0))}
    )
    entry = VehicleEntry(
        model="bluerov2", position_ned_m=(0.0, 0.0, 30.0), velocity_frd_mps=(1.5, 0.3, 0.0), sensors={"lbl": lbl},
        truth=Truth(rate_hz=240),
    )  # fmt: skip
    world = build(load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}))
    samples = world.step(960)
    truth = {s.t_ns: s.value[0] for s in samples if s.port == "rov/truth/pose"}
    times = np.array([*truth])
    found = [s for s in samples if s.port == "rov/lbl"]
    assert len(found) >= 2
    for s in found:
        asked, heard = truth[s.t_ns], [np.interp(s.t_sent_ns, times, [p[k] for p in truth.values()]) for k in range(3)]
        expected = 0.5 * (math.dist(asked, (900.0, 0.0, 30.0)) + math.dist(heard, (900.0, 0.0, 30.0)))
        assert math.dist(asked, heard) > 0.1
        assert s.value[RANGE] == pytest.approx(expected, abs=1e-5)
