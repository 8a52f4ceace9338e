"""Actions as a table: which a world has, what their goals ask for, and that their types are those of rosidl."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from ros_rig import flying
from uwserver_adapters.ros.messages import BadMessage, Catalogue, Facts, Types
from uwserver_adapters.ros.messages.actions import ABORTED, CANCELED, SUCCEEDED, end_of

from uwserver.ports import Fault

TYPES = Types()


def actions(types=TYPES):
    return Catalogue.of(types, Facts(), flying()).actions


def pose(x, y, z, yaw=None, frame="map"):
    orientation = {} if yaw is None else {"w": math.cos(yaw / 2), "z": math.sin(yaw / 2)}
    if yaw is None:
        orientation = {"w": 0.0}
    made = TYPES.make(
        "geometry_msgs/msg/Pose", position=TYPES.point((x, y, z)),
        orientation=TYPES.make("geometry_msgs/msg/Quaternion", **orientation),
    )  # fmt: skip
    return TYPES.make("geometry_msgs/msg/PoseStamped", header=TYPES.header(0, frame), pose=made)


def goal(name, **fields):
    action = actions()[name]
    return action.ask(TYPES.make(f"{action.type}_Goal", **fields))


def test_hashes_are_those_that_rosidl_publishes():
    """Of example_interfaces/action/Fibonacci and action_msgs, as installations of jazzy tell them."""
    types = Types()
    types.register_action("example_interfaces/action/Fibonacci", "int32 order", "int32[] sequence", "int32[] sequence")
    name = "example_interfaces/action/Fibonacci"
    assert types.hash(f"{name}_SendGoal") == "RIHS01_d1a57fb2a4afe8c21e34fb10db206f16ce6729b28531141472df92277c55b557"
    assert types.hash(f"{name}_GetResult") == "RIHS01_1b0de0d5d29dc955d92f546706568428632771db13ec84c15ec1c1a59f424a57"
    told = types.hash(f"{name}_FeedbackMessage")
    assert told == "RIHS01_c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2"
    cancel = "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"
    assert types.hash("action_msgs/srv/CancelGoal") == cancel
    status = "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"
    assert types.hash("action_msgs/msg/GoalStatusArray") == status
    get = "RIHS01_bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc"
    assert types.hash("rcl_interfaces/srv/GetParameters") == get


@pytest.mark.parametrize("distro", ["humble", "jazzy", "kilted", "rolling"])
def test_a_world_has_the_actions_of_its_long_calls(distro):
    types = Types(distro)
    made = actions(types)
    assert {name: action.type for name, action in made.items()} == {
        "/rov/goto": "uwserver_msgs/action/Goto",
        "/rov/mission": "uwserver_msgs/action/Mission",
        "/uwserver/simulate_steps": "simulation_interfaces/action/SimulateSteps",
    }
    for action in made.values():
        for part in ("Goal", "Result", "Feedback", "FeedbackMessage", "SendGoal_Request", "GetResult_Response"):
            blank = types.make(f"{action.type}_{part}")
            types.from_cdr(types.cdr(blank), f"{action.type}_{part}")


def test_ros1_has_none():
    assert actions(Types("noetic")) == {}


def test_a_place_in_map_is_one_in_ned():
    asked = goal("/rov/goto", pose=pose(1.0, 2.0, -3.0, yaw=0.0), speed=0.5)
    assert asked.service == "rov/autopilot/goto"
    heading = asked.args.pop("heading_deg")
    assert heading == pytest.approx(90.0)  # x of map is east
    assert asked.args == {"position_ned_m": [2.0, 1.0, 3.0], "speed_mps": 0.5}
    assert goal("/rov/goto", pose=pose(1.0, 2.0, -3.0)).args == {"position_ned_m": [2.0, 1.0, 3.0]}


def test_a_pose_elsewhere_is_refused():
    with pytest.raises(BadMessage, match="rov/base_link"):
        goal("/rov/goto", pose=pose(1.0, 2.0, -3.0, frame="rov/base_link"))


def test_a_mission_is_poses_or_items_or_the_one_that_is_there():
    assert goal("/rov/mission", first=2).args == {"index": 2}
    asked = goal("/rov/mission", poses=[pose(1.0, 2.0, -3.0), pose(0.0, 0.0, -1.0, yaw=math.pi / 2)])
    first, second = asked.args["items"]
    assert first == {"kind": "waypoint", "position_ned_m": [2.0, 1.0, 3.0]}
    assert second["heading_deg"] == pytest.approx(0.0, abs=1e-9)
    items = [{"kind": "hold", "time_s": 1.0}]
    assert goal("/rov/mission", items=json.dumps(items)).args == {"index": 0, "items": items}
    with pytest.raises(BadMessage, match="not both"):
        goal("/rov/mission", items="[]", poses=[pose(0.0, 0.0, 0.0)])
    with pytest.raises(BadMessage, match="JSON"):
        goal("/rov/mission", items="[")


def test_results_and_feedback():
    made = actions()
    there = made["/rov/goto"].result({"distance_m": 0.1}, None)
    assert (there.success, there.message, there.distance) == (True, "", 0.1)
    lost = made["/rov/goto"].result(None, Fault("denied", "not armed"))
    assert (lost.success, lost.message) == (False, "not armed")
    assert np.isnan(lost.distance)
    assert made["/rov/mission"].result({"reached": 3}, None).reached == 3
    steps = made["/uwserver/simulate_steps"]
    told = steps.feedback(TYPES.make(f"{steps.type}_Goal", steps=10), 0.3)
    assert (told.completed_steps, told.remaining_steps) == (3, 7)
    assert steps.ask(TYPES.make(f"{steps.type}_Goal", steps=10)).args == {"n": 10}
    assert steps.result(None, Fault("busy", "it runs")).result.result == 3


def test_how_a_goal_ends():
    preempted = Fault("preempted", "another goto was called")
    assert end_of(None, False) == end_of(None, True) == SUCCEEDED
    assert end_of(preempted, True) == CANCELED
    assert end_of(preempted, False) == end_of(Fault("denied", "no"), True) == ABORTED
