"""The built-in autopilot on a vessel with two thrusters, and what it says of a glider."""

from __future__ import annotations

import math

import pytest

from uwserver.frames import rpy_from_quat
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load

UNDER_IT = {
    "sensors": {
        "depth": {"kind": "pressure", "output": "depth", "rate_hz": 48.0, "mount": "transducer"},
        "dvl": {"kind": "dvl", "rate_hz": 8.0, "processing_s": 0.05, "mount": "transducer"},
    }
}
"""What modes with a place or a speed want to know; heading by its own compass."""


def sailing(fly, **options):
    f = fly("otter", start=(0.0, 0.0, 0.0), override=UNDER_IT, without=("ahrs", "dvl", "altimeter"), **options)
    f.run(2.0)
    f.call("arm")
    return f


def test_it_holds_speed_and_heading_across_a_current(fly):
    f = sailing(fly, current=(0.0, 0.2, 0.0))
    f.call("set_mode", mode="velocity")
    order = {"v_B": [2.0, 0.0, 0.0], "heading": 1.0}
    f.run(30.0, velocity=order)
    worst = believed = 0.0
    for _ in range(10):
        f.run(1.0, velocity=order)
        worst = max(worst, f.off_heading(1.0))
        believed = max(believed, abs(math.degrees(rpy_from_quat(f.state["q_NB"])[2] - 1.0)))
    assert believed < 1.0
    assert worst < 6.0  # three standard deviations of its compass
    assert f.vehicle.nu[0] == pytest.approx(2.0, abs=0.1)
    assert abs(f.vehicle.p_NB[2]) < 0.05


def test_it_sails_a_mission_and_stays_near_its_end(fly):
    f = sailing(fly, current=(0.0, 0.1, 0.0))
    places = [(40.0, 0.0), (40.0, 40.0), (0.0, 40.0)]
    items = [{"kind": "speed", "speed_mps": 1.5}]
    items += [{"kind": "waypoint", "position_ned_m": [x, y, 0.4], "radius_m": 2.0} for x, y in places]
    f.call("set_mission", items=items)
    f.call("start_mission")
    nearest = [math.inf] * 3
    for _ in range(300):
        f.run(0.5)
        nearest = [min(n, math.dist(f.vehicle.p_NB[:2], p)) for n, p in zip(nearest, places, strict=True)]
    assert f.state["mission_index"] == -1
    assert max(nearest) < 2.5
    assert math.dist(f.vehicle.p_NB[:2], places[-1]) < 8.0


def test_heading_hold_wants_the_compass_alone(fly):
    f = fly("otter", start=(0.0, 0.0, 0.0), bottom=None, without=("ahrs",))
    f.run(3.0)
    f.call("arm")
    f.call("set_mode", mode="heading_hold")
    f.send("heading", heading=0.7)
    f.run(30.0, pilot={"u": [0.5, 0, 0, 0, 0, 0]})
    assert f.off_heading(0.7) < 5.0
    assert f.vehicle.nu[0] > 0.5


def test_a_glider_has_nothing_to_steer_with():
    b = ScenarioBuilder("glider", adapters={})
    b.vehicle("v", "slocum", autopilot={})
    with pytest.raises(ScenarioError, match="it cannot steer this vehicle"):
        load(b.build(), adapters={})
