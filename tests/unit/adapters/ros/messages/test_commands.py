"""Commands and services in ROS' words: what they ask of the world, and what is refused."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from ros_rig import DEG, catalogue
from uwserver_adapters.ros.messages import BadMessage, Types
from uwserver_adapters.ros.messages.commands import command_topics
from uwserver_adapters.ros.messages.frames import attitude
from uwserver_adapters.ros.messages.plain import built
from uwserver_adapters.ros.messages.services import Ask, offers

from uwserver.frames import quat_from_rpy
from uwserver.ports import Argument, Fault, Field, Port, Service


@pytest.fixture
def made():
    return catalogue()


def value(made, topic, given):
    command_topic = made.command_topics[topic]
    return command_topic.port, command_topic.value(built(made.types, command_topic.type, given))


def test_topics_of_commands(made):
    assert {command_topic.name: command_topic.type.replace("/msg", "") for command_topic in made.command_topics.values()} == {
        "/rov/thrusters/cmd": "std_msgs/Float64MultiArray", "/rov/thrusters/t1/cmd": "std_msgs/Float64",
        "/rov/thrusters/t2/cmd": "std_msgs/Float64", "/rov/thrusters/t3/cmd": "std_msgs/Float64", "/rov/fin/cmd": "std_msgs/Float64",
        "/rov/tow/cmd": "geometry_msgs/Wrench", "/rov/tow/cmd_stamped": "geometry_msgs/WrenchStamped",
        "/rov/teleport/cmd": "geometry_msgs/PoseStamped", "/rov/cmd_vel": "geometry_msgs/Twist",
        "/rov/cmd_vel_stamped": "geometry_msgs/TwistStamped", "/rov/cmd_pose": "geometry_msgs/PoseStamped",
        "/rov/cmd_depth": "std_msgs/Float64", "/rov/joy": "sensor_msgs/Joy", "/rov/lamp/cmd": "uwserver_msgs/LampCommand",
    }  # fmt: skip


def test_numbers_reach_their_actuator(made):
    assert value(made, "/rov/thrusters/cmd", {"data": [0.1, 0.2, 0.3]}) == ("rov/thrusters", {"u": [0.1, 0.2, 0.3]})
    assert value(made, "/rov/fin/cmd", {"data": 0.25}) == ("rov/fin", {"angle_rad": 0.25})
    assert value(made, "/rov/cmd_depth", {"data": 5.0}) == ("rov/autopilot/depth", {"depth": 5.0})


def test_one_thruster_alone_leaves_the_others_as_they_were_told(made):
    held = made.command_topics["/rov/thrusters/cmd"].held

    def ask(topic, data):
        told = value(made, f"/rov/thrusters/{topic}", {"data": data})[1]["u"]
        held.ask(told)
        return told

    all_of, two, three = ask("cmd", [0.1, 0.2, 0.3]), ask("t2/cmd", -0.5), ask("t3/cmd", 0.7)
    assert three == [0.1, -0.5, 0.7]  # before the world has answered to any
    for told, is_accepted in ((all_of, True), (two, True), (three, False)):
        held.judge(told, is_accepted)
    assert held.newest == [0.1, -0.5, 0.3]  # what was refused is not held
    held.forget()
    assert ask("t1/cmd", 0.25) == [0.25, 0.0, 0.0]


def test_vectors_come_in_flu_and_enu(made):
    force = {"force": {"x": 1, "y": 2, "z": 3}, "torque": {"x": 4, "y": 5, "z": 6}}
    wanted = {"force_B": [1, -2, -3], "torque_B": [4, -5, -6]}
    assert value(made, "/rov/tow/cmd", force)[1] == wanted
    assert value(made, "/rov/tow/cmd_stamped", {"header": {"frame_id": "rov/base_link"}, "wrench": force})[1] == wanted
    twist = {"linear": {"x": 1, "y": 2, "z": 3}, "angular": {"z": 0.5}}
    assert value(made, "/rov/cmd_vel", twist)[1] == {"v_B": [1, -2, -3], "yaw_rate": -0.5}
    sticks = {"axes": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]}
    assert value(made, "/rov/joy", sticks)[1]["u"] == pytest.approx([0.1, -0.2, -0.3, 0.4, -0.5, -0.6])


def test_a_pose_is_in_map(made):
    q = attitude(quat_from_rpy(0.0, 0.0, 30 * DEG))
    pose = {
        "position": {"x": 1, "y": 2, "z": -3},
        "orientation": dict(zip("wxyz", q, strict=True)),
    }
    port, told = value(made, "/rov/cmd_pose", {"header": {"frame_id": "map"}, "pose": pose})
    assert (port, told["p_N"]) == ("rov/autopilot/position", [2, 1, 3])
    assert told["heading"] == pytest.approx(30 * DEG)
    assert "heading" not in value(made, "/rov/cmd_pose", {"pose": {"position": {"x": 1}}})[1]
    assert value(made, "/rov/teleport/cmd", {"pose": pose})[1]["q_NB"] == pytest.approx(quat_from_rpy(0, 0, 30 * DEG))


BOAT = Port(
    "boat/pose", "actuator", "pose", (
        Field("p_NB", "m", "place", "N", (3,)), Field("q_NB", "1", "attitude", "NB", (4,)), Field("v_NB_B", "m/s", "speed", "B", (3,)),
        Field("w_NB_B", "rad/s", "rate", "B", (3,)), Field("stamp", "s", "when"),
    ), "An external vehicle.", message="FollowedPose",
)  # fmt: skip


def test_an_external_vehicle_follows_odometry():
    types = Types()
    found = {command_topic.name: command_topic for command_topic in command_topics(types, BOAT)}
    assert set(found) == {"/boat/pose/cmd", "/boat/pose/odometry"}

    def follow(topic, **given):
        command_topic = found[topic]
        return command_topic.value(built(types, command_topic.type, given))

    q = dict(zip("wxyz", attitude(quat_from_rpy(0.0, 0.0, 30 * DEG)), strict=True))
    pose = {"position": {"x": 1.0, "y": 2.0, "z": -3.0}, "orientation": q}
    header = {"frame_id": "map", "stamp": {"sec": 5, "nanosec": 250_000_000}}
    twist = {"twist": {"linear": {"x": 1.0, "y": 2.0, "z": 3.0}, "angular": {"z": 0.5}}}
    told = follow("/boat/pose/odometry", header=header, child_frame_id="base_link", pose={"pose": pose}, twist=twist)
    assert told.pop("q_NB") == pytest.approx(quat_from_rpy(0.0, 0.0, 30 * DEG))
    assert told == {"p_NB": [2.0, 1.0, 3.0], "stamp": 5.25, "v_NB_B": [1.0, -2.0, -3.0], "w_NB_B": [0.0, 0.0, -0.5]}
    unknown = {**twist, "covariance": [-1.0] + [0.0] * 35}
    assert follow("/boat/pose/odometry", twist=unknown) == {"p_NB": [0.0, 0.0, 0.0]}
    assert follow("/boat/pose/cmd", pose={"position": pose["position"]}) == {"p_NB": [2.0, 1.0, 3.0]}
    for wrong in (
        {"child_frame_id": "odom"},
        {"header": {"frame_id": "odom"}},
        {"pose": {"pose": {"orientation": {"w": 3.0}}}},
    ):
        with pytest.raises(BadMessage):
            follow("/boat/pose/odometry", **wrong)


@pytest.mark.parametrize(
    ("topic", "given", "text"),
    [
        ("/rov/tow/cmd_stamped", {"header": {"frame_id": "map"}}, 'frame_id is "map": give it in rov/base_link'),
        ("/rov/cmd_pose", {"header": {"frame_id": "odom"}}, "give it in map"),
        ("/rov/cmd_pose", {"pose": {"orientation": {"w": 2.0}}}, "no unit quaternion"),
        ("/rov/cmd_vel", {"angular": {"x": 1}}, "must be 0"),
        ("/rov/joy", {"axes": [1.0, 2.0]}, "must have 6 items"),
    ],
)
def test_what_cannot_be_meant_is_refused(made, topic, given, text):
    with pytest.raises(BadMessage, match=text):
        value(made, topic, given)


def test_an_unknown_actuator_has_a_message_of_its_own(made):
    assert value(made, "/rov/lamp/cmd", {"power": 0.5, "colour": "red"})[1] == {"power": 0.5, "colour": "red"}
    assert value(made, "/rov/lamp/cmd", {"power": None, "colour": "red"})[1] == {"colour": "red"}  # nan: left out
    arm = Port(
        "rov/arm",
        "actuator",
        "arm",
        (Field("q", "rad", "joints", shape=(2,)), Field("grip", "1", "hand", type="str")),
        "Arm.",
    )
    types = Types()
    (command_topic,) = command_topics(types, arm)
    assert command_topic.value(built(types, command_topic.type, {"q": [1.0, 2.0]})) == {"q": [1.0, 2.0]}


# -- services -----------------------------------------------------------------------------------------------------------------------------

SERVICES = (
    Service("world/status", "State.", reads_only=True),
    Service("world/pause", "Stop."),
    Service("world/resume", "Go on."),
    Service("world/reset", "Again."),
    Service("world/remove", "Away.", (Argument("name", "str", "who"),)),
    Service("world/step", "Run.", (Argument("n", "int", "ticks", required=False, default=1),), long_running=True),
    Service("rov/autopilot/arm", "Arm.", (Argument("force", "bool", "anyway", required=False, default=False),)),
    Service("rov/autopilot/disarm", "Disarm."),
    Service("rov/autopilot/set_mode", "Mode.", (Argument("mode", "str", "which", choices=("manual", "depth_hold")),)),
    Service("rov/autopilot/set_mission", "Fly.", (Argument("items", "json", "items"),)),
    Service(
        "rov/autopilot/goto", "Go.",
        (Argument("p_N", "float", "place", shape=(3,)), Argument("radius_m", "float", "near", required=False)), long_running=True,
    ),
)  # fmt: skip


@pytest.fixture
def served():
    types = Types()
    found = {offer.name: offer for offer in offers(types, SERVICES)}

    def ask(name, given=None):
        offer = found[name]
        return offer.ask(built(types, f"{offer.type}_Request", given or {}))

    return SimpleNamespace(types=types, offers=found, ask=ask)


def test_services_without_arguments_are_triggers(served):
    assert served.offers["/world/pause"].type == "std_srvs/srv/Trigger"
    assert served.ask("/world/pause") == Ask("world/pause", {})
    good = served.offers["/world/pause"].answer({"x": 1}, None)
    assert (good.success, json.loads(good.message)) == (True, {"x": 1})
    bad = served.offers["/world/pause"].answer(None, Fault("busy", "not now", "world/pause"))
    assert (bad.success, bad.message) == (False, "not now")


def test_arguments_are_fields_and_what_may_be_left_out_is_a_list(served):
    assert served.ask("/world/step") == Ask("world/step", {})
    assert served.ask("/world/step", {"n": [5]}) == Ask("world/step", {"n": 5})
    with pytest.raises(BadMessage, match="at most 1"):
        served.ask("/world/step", {"n": [5, 6]})
    assert served.ask("/rov/autopilot/goto", {"p_n": [1.0, 2.0, 3.0]}).args == {"p_N": [1.0, 2.0, 3.0]}
    assert served.ask("/rov/autopilot/goto", {"p_n": [1.0, 2.0, 3.0], "radius_m": [2.0]}).args["radius_m"] == 2.0
    assert served.ask("/rov/autopilot/set_mission", {"items": '[{"a": 1}]'}).args == {"items": [{"a": 1}]}
    with pytest.raises(BadMessage, match="no JSON"):
        served.ask("/rov/autopilot/set_mission", {"items": "[" * 100_000})
    done = served.offers["/world/step"].answer({"tick": 5}, None)
    assert json.loads(done.result) == {"tick": 5}


def test_words_of_ros_users(served):
    assert served.ask("/rov/arm", {"data": True}) == Ask("rov/autopilot/arm", {})
    assert served.ask("/rov/arm", {"data": False}) == Ask("rov/autopilot/disarm", {})
    assert served.ask("/rov/mode/depth_hold") == Ask("rov/autopilot/set_mode", {"mode": "depth_hold"})


def test_any_service_by_its_name(served):
    assert served.ask("/uwserver/call", {"service": "/world/step", "arguments": '{"n": 3}'}) == Ask(
        "world/step", {"n": 3}
    )
    assert served.ask("/uwserver/call", {"service": "world/pause"}) == Ask("world/pause", {})
    with pytest.raises(BadMessage, match="JSON object"):
        served.ask("/uwserver/call", {"service": "world/step", "arguments": "[]"})


def test_every_request_and_response_has_bytes(served):
    for offer in served.offers.values():
        for part in ("Request", "Response"):
            message = served.types.make(f"{offer.type}_{part}")
            served.types.from_cdr(served.types.cdr(message), f"{offer.type}_{part}")
        assert served.types.hash(offer.type).startswith("RIHS01_")
