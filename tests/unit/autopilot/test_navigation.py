"""Positions from the real sensors: how far the estimate is from the truth with each kind of fix."""

from __future__ import annotations

import math

import pytest

from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load

BEACONS = {
    "a": {"position_ned_m": [60.0, 0.0, 25.0]},
    "b": {"position_ned_m": [-40.0, 50.0, 25.0]},
    "c": {"position_ned_m": [-20.0, -60.0, 25.0]},
}


@pytest.fixture
def drifting(flying):
    """A ROV that drifts in a current, 3 m and 4 m away from where its autopilot thinks that it begins."""

    def built(kind, depth=5.0, start=None, **keys):
        builder = ScenarioBuilder("navigation", seed=5, adapters={})
        builder.world(origin_lat_deg=63.0, origin_lon_deg=10.0)
        builder.current(velocity_ned_mps=[0.1, -0.1, 0.0])
        config = {} if start is None else {"start_position_ned_m": start}
        place = {"position_ned_m": [3.0, 4.0, depth], "attitude_rpy_deg": [0, 0, 40]}
        builder.vehicle("v", "bluerov2_heavy", autopilot=config, **place)
        builder.sensor("v", "ahrs", "attitude", rate_hz=40)
        builder.sensor("v", kind, kind, **keys)
        return flying(build(load(builder.build(), adapters={})))

    return built


def error(f):
    return math.dist(f.state["p_N"][:2], f.vehicle.p_NB[:2])


@pytest.mark.parametrize("start", [None, [0.0, 0.0, 5.0]])
def test_ranges_of_a_long_baseline(drifting, start):
    f = drifting("lbl", rate_hz=4, beacons=BEACONS, start=start)
    f.run(40.0)
    assert f.state["position_valid"]
    assert error(f) < 0.5


def test_fixes_of_an_ultra_short_baseline(drifting):
    f = drifting("usbl", rate_hz=2, beacons={"a": BEACONS["a"]}, position_frd_m=[0, 0, 0.2])
    f.run(30.0)
    assert f.state["position_valid"]
    assert error(f) < 1.5


def test_satellites_at_the_surface(drifting):
    f = drifting("gps", depth=-0.02, rate_hz=5, noise_m=0.5, position_frd_m=[0, 0, -0.4])
    f.run(20.0)
    assert f.state["position_valid"]
    assert error(f) < 0.5
    assert math.hypot(*f.state["p_N"][:2]) > 3.0


def test_cameras_of_a_pool_alone_are_enough_to_hold_a_place(drifting):
    f = drifting("motion_capture", rate_hz=60, latency_s=0.01)
    f.run(1.0)
    assert f.state["velocity_valid"]
    f.call("set_mode", mode="position_hold")
    f.call("arm")
    place = f.state["p_N"]
    f.run(25.0)
    assert math.dist(f.vehicle.p_NB, place) < 0.1


def test_a_fix_that_stops_leaves_a_position_that_is_lost_later(drifting):
    f = drifting("motion_capture", rate_hz=60, latency_s=0.01)
    f.run(5.0)
    f.world.call("world/set_fault", name="dark", kind="sensor_silent", target="v/motion_capture")
    f.run(4.0)
    assert f.state["position_valid"]
    f.run(2.0)
    assert not f.state["position_valid"]
