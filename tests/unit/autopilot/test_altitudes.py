"""Ways at an altitude: how near, over slopes and walls, without echoes, and what is refused. docs/how-to/autopilot.md says the figures."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from uwserver.ports import Refused
from uwserver.world.state import snapshot

PAGE = Path(__file__).parents[3] / "docs/how-to/autopilot.md"
LOW, TOE = 40.0, 0.0
"""Depth of the level bottom in the south, and where it begins to rise to the north."""


def hill(path, degrees, rise=12.0):
    """Level, up a slope to the north, level; returns the depth by north."""
    grade = math.tan(math.radians(degrees))

    def depth(north):
        return LOW - min(rise, max(0.0, grade * (north - TOE)))

    rows = [[depth(north)] * 21 for north in np.arange(-200.0, 201.0, 2.0)]
    np.save(path, rows)
    return depth


def item(north, altitude, **keys):
    return {"kind": "waypoint", "position_ne_m": [north, 0.0], "altitude_m": altitude, **keys}


def flown(f, depth, items, seconds=400):
    """Altitude as it truly was, four times a second, until the mission is done."""
    f.call("set_mission", items=items)
    f.call("arm")
    f.call("start_mission")
    altitudes = []
    for _ in range(4 * seconds):
        f.run(0.25)
        north, _, down = f.vehicle.p_NB
        altitudes.append(depth(north) - down)
        if f.state["mission_index"] == -1:
            return altitudes
    raise AssertionError(f"not there after {seconds} s: {f.state}")


def rms(altitudes, wanted):
    return math.sqrt(sum((altitude - wanted) ** 2 for altitude in altitudes) / len(altitudes))


# Vehicle, speed, slope: RMS error and least altitude of a way at 5 m, as they are on the page.
SLOPES = [
    ("bluerov2_heavy", 0.5, 20),
    pytest.param("remus100", 1.5, 10, marks=pytest.mark.slow),
    ("remus100", 1.5, 20),
    pytest.param("lauv", 1.0, 10, marks=pytest.mark.slow),
    ("lauv", 1.0, 20),
]


@pytest.mark.parametrize(("model", "speed", "degrees"), SLOPES)
def test_an_altitude_is_kept_up_a_slope_as_near_as_the_page_says(fly, tmp_path, model, speed, degrees):
    depth = hill(tmp_path / "hill.npy", degrees)
    hovers = model == "bluerov2_heavy"
    start = -10.0 if hovers else -40.0
    f = fly(model, start=(start, 0.0, LOW - 5.0), speed=0.0 if hovers else speed, terrain=tmp_path / "hill.npy")
    end = TOE + 12.0 / math.tan(math.radians(degrees)) + (5.0 if hovers else 40.0)
    altitudes = flown(f, depth, [item(end, 5.0, speed_mps=speed, radius_m=2.0)])
    found = [rms(altitudes, 5.0), min(altitudes)]
    print(f"{model} {degrees} degrees: {found[0]:.2f} m, least {found[1]:.2f} m")
    # Half of the altitude is left where the slope is as steep as a torpedo climbs.
    assert min(altitudes) > 2.5
    row = re.search(rf"\| {model} \| {speed} \| {degrees} \| ([\d.]+) \| ([\d.]+) \|", PAGE.read_text())
    assert row is not None
    assert found == pytest.approx([float(row[1]), float(row[2])], abs=0.05)


def test_down_a_slope_the_altitude_is_kept_too(fly, tmp_path):
    """Heading south: what was learnt of the slope is in N, and holds on the way back."""
    depth = hill(tmp_path / "hill.npy", 20)
    f = fly("bluerov2_heavy", start=(45.0, 0.0, depth(45.0) - 4.0), yaw_deg=180.0, terrain=tmp_path / "hill.npy")
    altitudes = flown(f, depth, [item(-10.0, 4.0, speed_mps=0.5, radius_m=1.0)])
    assert rms(altitudes, 4.0) < 0.15
    assert abs(f.vehicle.p_NB[0] + 10.0) < 1.5


def test_where_the_bottom_rises_faster_than_it_climbs_a_rov_goes_slower(fly, tmp_path):
    """Seventy degrees: at its speed it would need 1.4 m/s upwards and has 0.4."""
    depth = hill(tmp_path / "hill.npy", 70)
    f = fly("bluerov2_heavy", start=(-8.0, 0.0, LOW - 3.0), terrain=tmp_path / "hill.npy")
    altitudes = flown(f, depth, [item(15.0, 3.0, speed_mps=0.5, radius_m=1.0)])
    assert min(altitudes) > 0.6
    assert altitudes[-1] == pytest.approx(3.0, abs=0.4)


def test_depth_and_altitude_take_turns(fly):
    """Down to 5 m over the bottom, along at it, up to a depth, and to the surface."""
    f = fly("bluerov2_heavy", bottom=30.0, start=(0.0, 0.0, 18.0))
    items = [
        item(0.0, 5.0),
        item(4.0, 5.0),
        {"kind": "waypoint", "position_ne_m": [4.0, 4.0], "depth_m": 22.0},
        {"kind": "waypoint", "position_ned_m": [0.0, 4.0, 20.0]},
    ]
    f.call("set_mission", items=items)
    assert f.call("get_mission")["items"] == items
    f.call("arm")
    f.call("start_mission")
    places = []
    for _ in range(1600):
        f.run(0.25)
        places += [f.vehicle.p_NB] * (f.state["reached"] - len(places))
        if len(places) == 4:
            break
    # Two of them over the bottom at 30 m.
    assert [p[2] for p in places] == pytest.approx([25.0, 25.0, 22.0, 20.0], abs=0.3)
    assert f.state["depth_ref"] == 20.0


def test_goto_at_an_altitude_and_a_depth_that_ends_it(fly):
    f = fly("bluerov2_heavy", bottom=30.0, start=(0.0, 0.0, 24.0))
    f.call("arm")
    answers = f.post("goto", position_ne_m=[3.0, 0.0], altitude_m=4.0)
    f.run(30.0)
    assert answers[-1].fault is None
    assert f.vehicle.p_NB == pytest.approx((3.0, 0.0, 26.0), abs=0.3)
    assert f.state["p_ref_N"][2] == pytest.approx(26.0, abs=0.2)
    f.send("depth", depth=24.0)
    f.run(15.0)
    assert f.vehicle.p_NB[2] == pytest.approx(24.0, abs=0.2)


def test_it_goes_no_deeper_than_its_gain_says_and_no_nearer_to_the_bottom(fly):
    f = fly("bluerov2_heavy", bottom=30.0, start=(0.0, 0.0, 18.0), autopilot={"gains": {"max_depth_m": 20.0}})
    f.call("arm")
    f.call("set_mission", items=[item(3.0, 4.0)])
    f.call("start_mission")
    deepest = 0.0
    for _ in range(100):
        f.run(0.25)
        deepest = max(deepest, f.vehicle.p_NB[2])
    assert 19.8 < deepest < 20.3
    f.call("set_gain", name="max_depth_m", value=1000.0)
    f.call("set_gain", name="min_altitude_m", value=8.0)
    f.run(20.0)
    assert f.vehicle.p_NB[2] == pytest.approx(22.0, abs=0.3), "the mission is older than the gain, which still counts"


PLACED = {"sensors": {"mocap": {"kind": "motion_capture", "rate_hz": 10.0}}}


def test_without_echoes_it_holds_its_depth_says_so_and_goes_on_when_they_are_back(fly):
    f = fly("bluerov2_heavy", bottom=30.0, start=(0.0, 0.0, 25.0), override=PLACED)
    f.call("arm")
    f.call("set_mission", items=[item(200.0, 6.0, speed_mps=0.3)])
    f.call("start_mission")
    f.run(15.0)
    assert f.vehicle.p_NB[2] == pytest.approx(24.0, abs=0.2)
    for name in ("dvl", "altimeter"):
        f.world.call("world/set_fault", name=name, kind="sensor_silent", target=f"v/{name}")
    f.run(20.0)
    state = f.state
    assert (state["mode"], state["failsafe"]) == ("mission", "sensor altitude")
    assert f.vehicle.p_NB[2] == pytest.approx(24.0, abs=0.2)
    assert state["v_N"][0] == pytest.approx(0.3, abs=0.1), "the way goes on"
    assert len([text for text in f.events if "holds its depth of 24.0 m" in text]) == 1
    for name in ("dvl", "altimeter"):
        f.world.call("world/clear_fault", name=name)
    f.run(2.0)
    assert f.state["failsafe"] == ""
    assert f.events[-1] == '"v/autopilot" the bottom is seen again: it goes at an altitude of 6 m'


def test_a_waypoint_without_a_bottom_in_sight_is_reached_at_the_depth_where_it_is(fly):
    f = fly("bluerov2_heavy", bottom=300.0, start=(0.0, 0.0, 5.0), override=PLACED)
    f.call("arm")
    f.call(
        "set_mission", items=[item(2.0, 6.0), item(4.0, 6.0), {"kind": "waypoint", "position_ned_m": [6.0, 0.0, 5.0]}]
    )
    f.call("start_mission")
    f.run(40.0)
    assert f.state["reached"] == 3
    assert f.vehicle.p_NB == pytest.approx((6.0, 0.0, 5.0), abs=0.3)
    assert len([text for text in f.events if "the bottom is not seen" in text]) == 1, "once, not for each waypoint"
    assert f.state["failsafe"] == ""


def refusal(call, *args, **keys):
    with pytest.raises(Refused) as refused:
        call(*args, **keys)
    return refused.value.fault.text


def test_what_cannot_keep_an_altitude_is_refused_by_name(fly):
    f = fly("bluerov2", without=("dvl", "altimeter"))
    f.call("set_mission", items=[{"kind": "surface"}])
    text = refusal(f.call, "set_mission", items=[{"kind": "surface"}, item(1.0, 5.0)])
    assert text == "item 1: altitude_m needs a sensor of kind altimeter or dvl in the vehicle: give depth_m instead"
    assert f.call("get_mission")["items"] == [{"kind": "surface"}]
    f.call("arm")
    assert "altimeter or dvl" in refusal(f.call, "goto", position_ne_m=[1, 2], altitude_m=5.0)
    assert f.state["mode"] == "manual"
    near = refusal(fly("bluerov2").call, "set_mission", items=[item(1.0, 0.2)])
    assert near == "item 0: altitude_m = 0.2 is below the gain min_altitude_m of this vehicle, 0.5"
    assert "vehicles that dive" in refusal(
        fly("otter", start=(0.0, 0.0, 0.0)).call, "set_mission", items=[item(1.0, 5.0)]
    )


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ({}, ["place is missing", "position_ned_m"]),
        ({"position_ne_m": [1, 2]}, ["exactly one of depth_m and altitude_m", "neither"]),
        (
            {"position_ne_m": [1, 2], "depth_m": 1, "altitude_m": 2},
            ["exactly one of depth_m and altitude_m", "not both"],
        ),
        ({"position_ned_m": [1, 2, 3], "altitude_m": 2}, ["position_ned_m holds a depth", "beside altitude_m"]),
        ({"position_ned_m": [1, 2, 3], "depth_m": 2}, ["position_ned_m holds a depth", "beside depth_m"]),
        ({"position_ned_m": [1, 2, 3], "position_ne_m": [1, 2]}, ["position_ned_m holds a depth"]),
        ({"altitude_m": 2}, ["place is missing"]),
    ],
)
def test_a_place_has_a_depth_or_an_altitude(fly, place, words):
    f = fly("bluerov2")
    f.call("arm")
    for text in (
        refusal(f.call, "goto", **place),
        refusal(f.call, "set_mission", items=[{"kind": "surface"}, {"kind": "waypoint", **place}]),
    ):
        assert all(word in text for word in words), text
    assert f.state["mode"] == "manual"


def test_the_state_in_the_middle_of_a_slope_goes_on_bit_for_bit(fly, tmp_path):
    hill(tmp_path / "hill.npy", 20)
    f = fly("remus100", start=(-5.0, 0.0, LOW - 5.0), speed=1.5, terrain=tmp_path / "hill.npy")
    f.call("arm")
    f.call("set_mission", items=[item(60.0, 5.0, radius_m=3.0)])
    f.call("start_mission")
    f.run(10.0)
    kept = snapshot.take(f.world)
    f.run(5.0)
    first = snapshot.take(f.world).hash()
    snapshot.restore(f.world, kept)
    f.run(5.0)
    assert snapshot.take(f.world).hash() == first
