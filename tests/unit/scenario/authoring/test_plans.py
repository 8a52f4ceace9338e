"""Missions in files: what is wrong with them is found before a vehicle gets them."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import pytest
from uwserver_adapters.mavlink.vehicle import mission_items
from uwserver_adapters.mavlink.vehicle.bridge import Home
from uwserver_adapters.mavlink.vehicle.setpoints import GLOBAL_FRAMES, LOCAL_NED
from uwserver_adapters.mavlink.wire.dialect import Dialect, Entry

from uwserver.scenario.authoring.plans import (
    ABOVE_BOTTOM,
    ABOVE_SURFACE,
    COMMANDS,
    LOCAL,
    BadPlan,
    Checked,
    check_mission,
    check_plan,
    check_waypoints,
)


def item(command: int, *params: float | None, frame: int = 3, **more: Any) -> dict[str, Any]:
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": list(params), **more}


def plan(*items: dict[str, Any]) -> str:
    return json.dumps({"fileType": "Plan", "mission": {"items": items}})


PLACE = item(16, 0, 0, 0, None, 47.0, 8.0, -5.0)


def test_a_plan_is_counted_by_kind() -> None:
    assert check_plan(plan(item(22), item(178, 1, 0.5), PLACE, PLACE)) == Checked(
        "4 items: 1 take-off, 1 speed, 2 waypoints"
    )
    assert check_plan(plan()) == Checked("0 items")


def test_a_survey_counts_by_its_waypoints() -> None:
    survey = {"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": {"Items": [PLACE, PLACE]}}
    assert check_plan(plan(survey)).summary == "2 items: 2 waypoints"
    with pytest.raises(BadPlan, match='item 1: a "survey" without its waypoints'):
        check_plan(plan({"type": "ComplexItem", "complexItemType": "survey"}))


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (item(2000, doJumpId=7), "item 7: command 2000 is not supported in a mission"),
        (item(16, 0, 0, 0, 0, None, 8, -5), "item 1: its place is not a number"),
        (item(16, 0), "item 1: its place is not a number"),
        (item(16, 0, 0, 0, 0, 95, 8, -5), "item 1: there is no such latitude or longitude"),
        (item(16, 0, 0, 0, 0, 47, 8, -5, frame=10), "item 1: -5 m is no altitude above the bottom"),
        (item(16, 0, 0, 0, 0, 47, 8, -5, frame=9), "item 1: frame 9 is not supported"),
    ],
)
def test_what_a_vehicle_would_refuse(wrong: dict[str, Any], text: str) -> None:
    assert check_plan(plan(wrong)).faults == (text,)


def test_a_place_in_the_air_is_warned_of_once() -> None:
    high = item(16, 0, 0, 0, 0, 47, 8, 10)
    checked = check_plan(plan(PLACE, high, high))
    assert checked.faults == ()
    assert checked.warnings == ("item 2: 10 m is above the surface (2 such items): depths are negative altitudes",)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"mission": {"items": [1]}}', plan({"command": 16}), plan(item(16, "x"))]
)
def test_what_is_no_plan(text: str) -> None:
    with pytest.raises(BadPlan, match="this is no plan"):
        check_plan(text)


def test_a_mission_too_long() -> None:
    assert check_plan(plan(*[PLACE] * 701)).faults == ("a mission has at most 700 items, this one has 701",)


def test_waypoints_begin_behind_home() -> None:
    row = "1 0 3 16 0 0 0 0 47 8 -5 1"
    assert check_waypoints(f"QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 0 1\n{row}\n\n").summary == "1 item: 1 waypoint"
    with pytest.raises(BadPlan, match="line 2: twelve numbers are needed"):
        check_waypoints("QGC WPL 110\n0 1 0 16\n")
    with pytest.raises(BadPlan, match="line 2"):
        check_waypoints("QGC WPL 110\n0 1 0 16 0 0 0 0 x 8 0 1\n")


def test_a_mission_of_ours() -> None:
    assert check_mission('[{"kind": "waypoint", "position_ned_m": [1, 2, 3]}, {"kind": "surface"}]').summary == (
        "2 items: 1 waypoint, 1 surface"
    )
    (fault,) = check_mission('[{"kind": "waypiont"}]').faults
    assert fault.startswith('item 0: unknown kind "waypiont"')
    with pytest.raises(BadPlan, match="this is no JSON"):
        check_mission("[")


def test_commands_and_frames_are_those_that_the_adapter_takes() -> None:
    """Each command of MAVLink is given to the adapter, at a place that it takes."""
    dialect = Dialect()
    local = dialect.entry(LOCAL_NED)
    taken = {dialect.entry(mission_items.TAKEOFF).number}  # which is left out
    for number in range(3000):
        command = Entry(number, dialect.name("MAV_CMD", number))
        with contextlib.suppress(mission_items.BadItem):
            mission_items.translate(
                mission_items.Item(1, local, command, (1.0, 1.0, 0.0, 0.0), 1, 1, 1.0), Home((47.0, 8.0))
            )
            taken.add(number)
    assert taken == COMMANDS.keys()
    names = {*GLOBAL_FRAMES, *mission_items._TERRAIN_FRAMES, LOCAL_NED}
    assert {dialect.name("MAV_FRAME", number) for number in (*ABOVE_SURFACE, *ABOVE_BOTTOM, *LOCAL)} == names
