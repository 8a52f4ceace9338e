"""The node on DDS, against a second participant of CycloneDDS in a process of its own, on a domain of this machine alone."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from adapter_rig import serving
from ros_rig import PORTS, context, flying, sample

pytest.importorskip("cyclonedds")

from uwserver_adapters.ros2 import Ros2Adapter
from uwserver_adapters.ros2.config import Ros2Config

from uwserver.adapter import CannotServe

DOMAIN = 90 + os.getpid() % 100
RIG = str(Path(__file__).parents[3] / "unit")

PEER = """
import json, sys, time
sys.path.insert(0, sys.argv[2])
from cyclonedds.core import Listener
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.qos import Policy, Qos
from cyclonedds.util import duration
from idl_rig import Classes
from uwserver_adapters.ros2.rmw_dds import localhost, own_address, write
from uwserver_adapters.ros.messages import Types
import numpy as np

number, distro, call = int(sys.argv[1]), sys.argv[3], sys.argv[4] == "call"
domain = Domain(number, localhost(own_address()))
participant = DomainParticipant(number, Qos(Policy.Userdata(b"enclave=/;")))
types = Types(distro)
classes = Classes(types)
old = Policy.DataRepresentation(use_cdrv0_representation=True)
reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10), old)
best = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5), old)
latched = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1), old)
def topic(name, kind, **more):
    return Topic(participant, name, classes.of(kind, **more))
imu = DataReader(participant, topic("rt/rov/imu", "sensor_msgs/msg/Imu"), qos=best)
static = DataReader(participant, topic("rt/tf_static", "tf2_msgs/msg/TFMessage"), qos=latched)
graph = DataReader(participant, topic("ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"), qos=latched)
command = DataWriter(participant, topic("rt/rov/thrusters/cmd", "std_msgs/msg/Float64MultiArray"), qos=reliable)
publications = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
told = {"imus": 0}
def until(condition, what, again=lambda: None):
    # Something is done again each half second: what was sent before both sides had matched is for nobody.
    begin, done = time.monotonic(), 0
    while not condition():
        passed = time.monotonic() - begin
        assert passed < 60, what
        if passed >= 0.5 * done:
            done += 1
            again()
        time.sleep(0.01)
def heard():
    for one in imu.take(100):
        told["imus"] += 1
        told["z"] = one.linear_acceleration.z
        told["frame"] = one.header.frame_id
    return told["imus"] >= 50
until(heard, "imu")
def transforms():
    for one in static.take(10):
        told["frames"] = [t.child_frame_id for t in one.transforms]
    return "frames" in told
until(transforms, "tf_static")
def node():
    for one in graph.take(10):
        for entry in one.node_entities_info_seq:
            told["node"] = entry.node_namespace + entry.node_name
            told["writers"] = len(entry.writer_gid_seq)
            told["gid"] = len(entry.writer_gid_seq[0].data) if entry.writer_gid_seq else 0
    return told.get("writers", 0) > 40
until(node, "graph")
words = {}
def endpoints():
    for one in publications.take(200):
        words[one.topic_name] = (one.type_name, bytes(one.qos[Policy.Userdata].data if one.qos and one.qos[Policy.Userdata] else b""))
    return "rt/rov/imu" in words
until(endpoints, "endpoints")
told["type"], word = words["rt/rov/imu"]
told["hash"] = word.decode()
def send():
    command.write(classes.value(types.make("std_msgs/msg/Float64MultiArray", data=np.array([0.1, 0.2, 0.3]))))
    assert command.wait_for_acks(duration(seconds=60))
until(lambda: command.get_matched_subscriptions(), "command")
send()
if call:
    asks = DataWriter(participant, topic("rq/world/pauseRequest", "std_srvs/srv/Trigger_Request", in_service=True), qos=reliable)
    hears = DataReader(participant, topic("rr/world/pauseReply", "std_srvs/srv/Trigger_Response", in_service=True), qos=reliable)
    until(lambda: asks.get_matched_subscriptions() and hears.get_matched_publications(), "service")
    request = classes.of("std_srvs/srv/Trigger_Request", in_service=True)
    def ask():
        for k in range(3):
            asks.write(request(client_guid=77, sequence_number=k, structure_needs_at_least_one_member=0))
    answers = set()
    def answered():
        answers.update((one.client_guid, one.sequence_number, one.success) for one in hears.take(10))
        return len(answers) == 3
    until(answered, "answers", ask)
    told["answers"] = sorted(answers)
    goal = "uwserver_msgs/action/Goto_SendGoal"
    below = "/rov/goto/_action/"
    sends = DataWriter(participant, topic(f"rq{below}send_goalRequest", f"{goal}_Request", in_service=True), qos=reliable)
    taken = DataReader(participant, topic(f"rr{below}send_goalReply", f"{goal}_Response", in_service=True), qos=reliable)
    status = DataReader(participant, topic(f"rt{below}status", "action_msgs/msg/GoalStatusArray"), qos=latched)
    until(lambda: sends.get_matched_subscriptions() and taken.get_matched_publications(), "action")
    body = types.cdr(types.make(f"{goal}_Request"))
    goals = []
    def send_goal():
        goals.append(bytes([len(goals)]) * 16)
        write(sends, body[:4] + bytes(16) + goals[-1] + body[20:])
    def accepted():
        told["accepted"] = [one.accepted for one in taken.take(10)]
        return told["accepted"]
    until(accepted, "goal", send_goal)
    def running():
        told["statuses"] = [one.status for each in status.take(10) for one in each.status_list]
        return told["statuses"]
    until(running, "status")
print(json.dumps(told))
"""


def told_by(distro, call=False, **config):
    async def story():
        made = flying() if call else context()
        table = Ros2Config(transport="dds", allow_network=True, domain=DOMAIN, ros_distro=distro, truth=True, **config)
        async with serving(Ros2Adapter(table, made)):
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-c", PEER, str(DOMAIN), RIG, distro, "call" if call else "",
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
            try:
                ended = asyncio.ensure_future(process.communicate())
                while not ended.done():
                    made.put([sample(PORTS["rov/imu"])])
                    await asyncio.wait({ended}, timeout=0.01)
                out, err = ended.result()
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
            assert process.returncode == 0, (err.decode(), made.stats)
            while not made.commands:  # it has come, and is on its way to the loop
                await asyncio.sleep(0.01)
            return json.loads(out.decode().splitlines()[-1]), made

    return asyncio.run(asyncio.wait_for(story(), 180))


def test_another_participant_sees_hears_and_steers():
    told, world = told_by("jazzy", call=True, services=True)
    assert told["imus"] >= 50
    assert (told["z"], told["frame"]) == (9.81, "rov/base_link")
    assert told["frames"] == ["rov/odom"]
    assert (told["node"], told["gid"]) == ("/uwserver", 16)
    assert told["type"] == "sensor_msgs::msg::dds_::Imu_"
    assert told["hash"].startswith("typehash=RIHS01_7d9a00ff")
    assert world.commands[-1].value == ((0.1, 0.2, 0.3),)
    assert told["answers"] == [[77, 0, True], [77, 1, True], [77, 2, True]]
    assert (set(told["accepted"]), set(told["statuses"])) == ({True}, {2})


def test_humble_has_longer_identities_and_no_hashes():
    told, world = told_by("humble")
    assert (told["gid"], told["hash"]) == (24, "")
    assert world.commands[-1].value == ((0.1, 0.2, 0.3),)
    assert world.calls == []


def test_the_network_is_asked_for():
    async def story():
        adapter = Ros2Adapter(Ros2Config(transport="dds"), context())
        with pytest.raises(CannotServe, match="allow_network = true"):
            await adapter.run(asyncio.Event())

    asyncio.run(story())
    assert not Ros2Config(transport="dds").offers_services
    assert Ros2Config().offers_services


def test_the_loopback_and_the_own_address_are_listened_to():
    """Fast DDS asks by the loopback, rmw_cyclonedds by the machine's address: with one of them the other would not be found."""
    from uwserver_adapters.ros2.rmw_dds import localhost, own_address

    both = localhost("192.0.2.7")
    for word in (
        '<NetworkInterface address="127.0.0.1" multicast="false"/>',
        '<NetworkInterface address="192.0.2.7" multicast="false"/>',
    ):
        assert both.count(word) == 1
    assert '<Peers><Peer address="127.0.0.1"/><Peer address="192.0.2.7"/></Peers>' in both
    assert "<AllowMulticast>false<" in both
    alone = localhost("")
    assert alone.count("<NetworkInterface") == alone.count("<Peer ") == 1
    assert not own_address().startswith("127.")


def test_what_is_read_raw_keeps_the_name_of_its_type():
    """Another vendor matches endpoints by it; a class of each type is made once."""
    from uwserver_adapters.ros.messages import Types
    from uwserver_adapters.ros2.idl import Classes

    classes = Classes(Types())
    for in_service, name, wanted in (
        (False, "geometry_msgs/msg/Twist", "geometry_msgs::msg::dds_::Twist_"),
        (True, "std_srvs/srv/Trigger_Request", "std_srvs::srv::dds_::Trigger_Request_"),
    ):
        made = classes.raw(name, in_service)
        assert made.__idl__.idl_transformed_typename == wanted
        assert made is classes.raw(name, in_service)
        assert made is not classes.of(name, in_service)
        assert made.deserialize(b"abc").data == b"abc"
