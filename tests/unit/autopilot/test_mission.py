"""Missions as clients give them: what is read, what is shown again, and what is said about faults. Also of uwserver.autopilot.route."""

from __future__ import annotations

import math

import pytest

from uwserver.autopilot.mission import MAX_ITEMS, Hold, SetHeading, SetSpeed, Surface, Waypoint, read_items, shown_items
from uwserver.ports import Refused

GOOD = [
    {"kind": "speed", "speed_mps": 0.3},
    {"kind": "waypoint", "position_ned_m": [1, 2, 3], "radius_m": 0.5, "heading_deg": 90, "hold_s": 2},
    {"kind": "hold", "time_s": 5},
    {"kind": "heading", "heading_deg": -45.5},
    {"kind": "waypoint", "position_ned_m": [1.5, 2, 3]},
    {"kind": "surface"},
]


def test_all_kinds_are_read_and_shown_as_given():
    items = read_items(GOOD)
    assert [type(item) for item in items] == [SetSpeed, Waypoint, Hold, SetHeading, Waypoint, Surface]
    assert items[1].position_ned_m == (1.0, 2.0, 3.0)
    assert items[4].radius_m is None
    shown = shown_items(items)
    assert read_items(shown) == items
    assert shown[4] == {"kind": "waypoint", "position_ned_m": [1.5, 2.0, 3.0]}


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        ("up", ["must be a list"]),
        ({"kind": "surface"}, ["must be a list"]),
        ([3], ["item 0"]),
        ([GOOD[0], {"speed_mps": 1}], ["item 1", "kind"]),
        ([{"kind": "loiter"}], ["item 0", "loiter", "waypoint"]),
        ([GOOD[0], {"kind": "waypoint"}], ["item 1", "position_ned_m"]),
        ([{"kind": "waypoint", "position_ned_m": [1, 2]}], ["item 0", "position_ned_m"]),
        ([{"kind": "waypoint", "position_ned_m": [1, 2, "x"]}], ["item 0", "position_ned_m"]),
        ([{"kind": "waypoint", "position_ned_m": [1, 2, math.nan]}], ["item 0", "position_ned_m", "finite"]),
        ([{"kind": "waypoint", "position_ned_m": [1, 2, math.inf]}], ["item 0", "position_ned_m", "finite"]),
        ([{"kind": "waypoint", "position_ned_m": [1, 2, 1e9]}], ["item 0", "position_ned_m"]),
        ([{"kind": "waypoint", "position_ned_m": [1, 2, 3], "radius_m": 0}], ["item 0", "radius_m"]),
        ([{"kind": "waypoint", "position_ned_m": [1, 2, 3], "speed_mps": -1}], ["item 0", "speed_mps"]),
        ([{"kind": "waypoint", "position_ned_m": [1, 2, 3], "radius": 1}], ["item 0", "radius", "radius_m"]),
        ([{"kind": "hold", "time_s": -1}], ["item 0", "time_s"]),
        ([{"kind": "surface", "depth_m": 1}], ["item 0", "depth_m", "none"]),
        ([{"kind": "surface"}] * (MAX_ITEMS + 1), [str(MAX_ITEMS)]),
    ],
)
def test_a_fault_is_told_with_its_item_and_key(raw, words):
    with pytest.raises(Refused) as refused:
        read_items(raw)
    for word in words:
        assert word in refused.value.fault.text


def test_a_deep_value_is_refused():
    deep = []
    for _ in range(200):
        deep = [deep]
    with pytest.raises(Refused):
        read_items([{"kind": "waypoint", "position_ned_m": deep}])


@pytest.mark.parametrize(("own", "speed"), [({}, 0.2), ({"speed_mps": 0.4}, 0.4)])
def test_the_speed_of_a_mission_is_that_of_waypoints_without_their_own(fly, own, speed):
    f = fly("bluerov2")
    way = {"kind": "waypoint", "position_ned_m": [20.0, 0.0, 3.0], **own}
    f.call("set_mission", items=[{"kind": "speed", "speed_mps": 0.2}, way])
    f.call("arm")
    f.call("start_mission")
    f.run(6.0)
    assert f.vehicle.nu[0] == pytest.approx(speed, abs=0.04)


def test_who_is_carried_out_of_a_waypoints_circle_goes_on_counting_its_stay(fly):
    f = fly("bluerov2")
    f.call("set_mission", items=[{"kind": "waypoint", "position_ned_m": [0.0, 0.0, 3.0], "radius_m": 0.5, "hold_s": 6}])
    f.call("arm")
    f.call("start_mission")
    f.run(1.0)
    f.world.set_current((3.0, 0.0, 0.0))
    f.run(4.5)
    assert (f.state["reached"], f.vehicle.p_NB[0] > 1.0) == (0, True)
    f.run(1.0)
    assert (f.state["reached"], f.vehicle.p_NB[0] > 1.0) == (1, True)
