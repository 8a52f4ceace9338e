"""The node on zenoh, against a peer that speaks rmw_zenoh by hand: topics, services, the graph, and what does not fit.

docs/how-to/ros2.md needs a ROS 2 on the other side, which no package index has: what its commands put on the wire is said here.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from adapter_rig import serving
from ros_rig import PORTS, T_NS, context, flying, sample

from uwserver.ports import Buffer, Reply, Sample

zenoh = pytest.importorskip("zenoh")

from uwserver_adapters.ros.messages import Types  # noqa: E402
from uwserver_adapters.ros.messages.types import dds_name  # noqa: E402
from uwserver_adapters.ros2 import Ros2Adapter  # noqa: E402
from uwserver_adapters.ros2.config import Ros2Config  # noqa: E402
from uwserver_adapters.ros2.graph import Attachment, attachment, gid, parsed_token  # noqa: E402

PATIENCE_S = 60
AT_ONCE = {"scouting/delay": 1}
"""A session that nobody is to be looked for is open at once, and not after half a second."""


class Peer:
    """A node written by hand: a session that says what rmw_zenoh says. Its calls block, and run beside the loop."""

    def __init__(self, address, distro="jazzy", domain=0):
        config = zenoh.Config()
        settings = {
            "mode": '"client"', "connect/endpoints": f'["{address}"]', "scouting/multicast/enabled": "false",
            "transport/shared_memory/enabled": "false", "timestamping/enabled": "true",
        }  # fmt: skip
        for path, value in settings.items():
            config.insert_json5(path, value)
        self.session = zenoh.open(config)
        self.types = Types(distro)
        self.domain = domain
        self.held = []

    def key(self, name, kind):
        return f"{self.domain}/{name.strip('/')}/{dds_name(kind)}/{self.types.hash(kind)}"

    def token(self, kind, name, type_name, type_hash=None):
        zid = str(self.session.zid())
        parts = [
            "@ros2_lv",
            self.domain,
            zid,
            0,
            1,
            kind,
            "%",
            "%",
            "talker",
            name.replace("/", "%"),
            dds_name(type_name),
        ]
        text = "/".join(map(str, [*parts, type_hash or self.types.hash(type_name), "1:2:1,10:,:,:,,"]))
        self.held.append(self.session.liveliness().declare_token(text))
        return gid(text)

    def hear(self, topic, kind, latched=False):
        heard = queue.Queue()
        if latched:
            from zenoh import ext

            history = ext.HistoryConfig(detect_late_publishers=True)
            subscriber = ext.declare_advanced_subscriber(
                self.session, self.key(topic, kind), heard.put, history=history
            )
        else:
            subscriber = self.session.declare_subscriber(self.key(topic, kind), heard.put)
        self.held.append(subscriber)
        return heard

    def say(self, topic, kind, **fields):
        data = self.types.cdr(self.types.make(kind, **fields))
        attached = Attachment(1, time.time_ns(), bytes(16)).packed()
        # A slow reader makes it wait: else what is large is lost.
        block = zenoh.CongestionControl.BLOCK
        self.session.put(self.key(topic, kind), data, attachment=attached, congestion_control=block)

    def call(self, service, kind, /, sequence=1, data=None, **fields):
        who = self.token("SC", service, kind)
        data = self.types.cdr(self.types.make(f"{kind}_Request", **fields)) if data is None else data
        attached = Attachment(sequence, time.time_ns(), who).packed()
        target = zenoh.QueryTarget.ALL_COMPLETE
        replies = list(
            self.session.get(
                self.key(service, kind), payload=data, attachment=attached, target=target, timeout=PATIENCE_S
            )
        )
        (reply,) = replies
        back = attachment(reply.ok.attachment.to_bytes())
        assert (back.sequence, back.gid) == (sequence, who)
        return self.types.from_cdr(reply.ok.payload.to_bytes(), f"{kind}_Response")

    def graph(self):
        replies = self.session.liveliness().get(f"@ros2_lv/{self.domain}/**", timeout=60)
        return [str(reply.ok.key_expr) for reply in replies]


@contextlib.asynccontextmanager
async def node(distro="jazzy", made=None, **config):
    """The world, and a function that runs a call of the peer beside the loop."""
    made = made or context()
    table = Ros2Config(
        **{
            "listen": ("tcp/127.0.0.1:0",),
            "ros_distro": distro,
            "domain": 0,
            "truth": True,
            "config": AT_ONCE,
            **config,
        }
    )
    async with serving(Ros2Adapter(table, made)):
        loop, pool = asyncio.get_running_loop(), ThreadPoolExecutor(1)

        async def aside(work, *args, **more):
            return await loop.run_in_executor(pool, lambda: work(*args, **more))

        peer = await aside(Peer, made.stats.address, distro, table.domain)
        try:
            yield made, peer, aside
        finally:
            await aside(peer.session.close)
            pool.shutdown()


def run(story):
    asyncio.run(asyncio.wait_for(story(), 120))


async def until(condition):
    end = asyncio.get_running_loop().time() + PATIENCE_S
    while not condition():
        assert asyncio.get_running_loop().time() < end, "it does not come"
        await asyncio.sleep(0.02)


@pytest.mark.parametrize("distro", ["humble", "jazzy"])
def test_a_topic_is_heard_with_its_attachment(distro):
    async def story():
        async with node(distro) as (world, peer, aside):
            assert world.subscriptions == set()  # nothing is made for nobody
            heard = await aside(peer.hear, "/rov/imu", "sensor_msgs/msg/Imu")
            await until(lambda: "rov/imu" in world.subscriptions)
            for _ in range(3):
                world.put([sample(PORTS["rov/imu"])])
            first = await aside(heard.get, timeout=60)
            imu = peer.types.from_cdr(first.payload.to_bytes(), "sensor_msgs/msg/Imu")
            assert imu.linear_acceleration.z == 9.81
            stamp = imu.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == world.world.epoch_ns + T_NS
            attached = [
                attachment(s.attachment.to_bytes())
                for s in (first, *[await aside(heard.get, timeout=60) for _ in range(2)])
            ]
            assert [one.sequence for one in attached] == [1, 2, 3]
            tokens = await aside(peer.graph)
            (token,) = [t for t in tokens if "/MP/" in t and "/%rov%imu/" in t]
            assert {one.gid for one in attached} == {gid(token)}
            assert ("/TypeHashNotSupported/" in token) == (distro == "humble")
            assert abs(attached[0].stamp_ns - time.time_ns()) < 60e9
            peer.held.pop().undeclare()
            await until(lambda: world.subscriptions == set())

    run(story)


def test_the_graph_has_the_node_and_all_its_endpoints():
    async def story():
        async with node() as (_, peer, aside):
            tokens = await aside(peer.graph)
            assert [t for t in tokens if "/NN/" in t] == [t for t in tokens if t.endswith("/0/0/NN/%/%/uwserver")] != []
            ends = {(e.kind, e.name): e for e in map(parsed_token, tokens) if e is not None}
            assert ends["MP", "/rov/dvl"].type == "marine_acoustic_msgs::msg::dds_::Dvl_"
            assert ends["MP", "/rov/dvl"].hash == peer.types.hash("marine_acoustic_msgs/msg/Dvl")
            assert ends["MS", "/rov/cmd_vel"].type == "geometry_msgs::msg::dds_::Twist_"
            assert ends["SS", "/world/pause"].hash == peer.types.hash("std_srvs/srv/Trigger")
            assert {("MP", "/clock"), ("MP", "/tf"), ("MP", "/tf_static")} <= set(ends)
            assert len({t.split("/")[4] for t in tokens}) == len(tokens)  # every endpoint has a number of its own

    run(story)


def test_a_latched_topic_reaches_late_comers():
    async def story():
        async with node() as (_, peer, aside):
            heard = await aside(peer.hear, "/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
            said = await aside(heard.get, timeout=60)
            transforms = peer.types.from_cdr(said.payload.to_bytes(), "tf2_msgs/msg/TFMessage").transforms
            assert [one.child_frame_id for one in transforms] == ["rov/odom"]

    run(story)


def test_the_clock_runs_while_somebody_listens():
    async def story():
        async with node() as (world, peer, aside):
            heard = await aside(peer.hear, "/clock", "rosgraph_msgs/msg/Clock")
            await until(lambda: world.subscriptions)
            (path,) = world.subscriptions
            base = sample(PORTS[path])
            for k in range(5):
                world.put([Sample(path, k, k * 10**8, k * 10**8, True, base.value)])
            clocks = [
                peer.types.from_cdr((await aside(heard.get, timeout=60)).payload.to_bytes(), "rosgraph_msgs/msg/Clock")
                for _ in range(5)
            ]
            assert [one.clock.nanosec for one in clocks] == [k * 10**8 for k in range(5)]

    run(story)


def test_commands_reach_their_actuator_and_wrong_ones_are_counted():
    async def story():
        async with node() as (world, peer, aside):
            kind = "std_msgs/msg/Float64MultiArray"
            await aside(peer.say, "/rov/thrusters/cmd", kind, data=np.array([0.1, 0.2, 0.3]))
            await until(lambda: world.commands)
            assert world.commands[0].value == ((0.1, 0.2, 0.3),)
            await aside(peer.say, "/rov/thrusters/cmd", kind, data=np.array([np.nan, 0.2, 0.3]))
            await aside(peer.say, "/rov/thrusters/cmd", kind, data=np.zeros(5))
            await aside(peer.session.put, peer.key("/rov/thrusters/cmd", kind), b"\0\1\0\0\xff\xff\xff\xff")
            await aside(peer.session.put, peer.key("/rov/thrusters/cmd", kind), b"")
            await until(lambda: world.stats.errors == 4)
            assert world.stats.details["refused"] == {"not_finite": 1, "bad_shape": 1, "message": 2}
            assert len(world.commands) == 1

    run(story)


def test_services_are_answered_whatever_was_asked():
    async def story():
        async with node() as (world, peer, aside):
            answer = await aside(peer.call, "/world/pause", "std_srvs/srv/Trigger", sequence=42)
            assert (answer.success, answer.message) == (True, "")
            await aside(
                peer.types.register_service,
                "uwserver_msgs/srv/Step",
                "int64[<=1] n",
                "bool success\nstring message\nstring result",
            )
            answer = await aside(peer.call, "/world/step", "uwserver_msgs/srv/Step", n=np.array([7]))
            assert answer.success
            assert world.calls[-1].args == {"n": 7}
            answer = await aside(peer.call, "/world/step", "uwserver_msgs/srv/Step", data=b"\0\1\0\0\xff")
            assert (answer.success, "not of this type" in answer.message) == (False, True)
            answer = await aside(
                peer.call, "/uwserver/call", "uwserver_msgs/srv/Call", service="world/pause", arguments="["
            )
            assert (answer.success, "no JSON" in answer.message) == (False, True)
            answer = await aside(
                peer.call, "/uwserver/set_simulation_state", "simulation_interfaces/srv/SetSimulationState"
            )
            assert answer.result.result == 0
            # Without an attachment it is no client of ROS: its question is dropped, and nobody waits.
            key = peer.key("/world/pause", "std_srvs/srv/Trigger")
            assert await aside(lambda: list(peer.session.get(key, payload=b"\0\1\0\0\0", timeout=60))) == []

    run(story)


def test_what_would_cost_too_much_is_not_decoded(caplog):
    async def story():
        async with node() as (world, peer, aside):
            kind = "std_msgs/msg/Float64MultiArray"
            key = peer.key("/rov/thrusters/cmd", kind)
            many = b"\0\1\0\0" + (10_000).to_bytes(4, "little") + bytes(120_000)  # names of dimensions, all empty
            await aside(peer.session.put, key, many + bytes(8))
            await until(lambda: world.stats.errors == 1)
            assert "more than 65536 bytes" in caplog.text
            answer = await aside(
                peer.call,
                "/uwserver/call",
                "uwserver_msgs/srv/Call",
                service="world/pause",
                arguments=" " * 70_000 + "{}",
            )
            assert (answer.success, "more than 65536 bytes" in answer.message) == (False, True)
            answer = await aside(
                peer.call,
                "/uwserver/call",
                "uwserver_msgs/srv/Call",
                service="world/step",
                arguments='{"n": %s}' % ("[" * 40 + "]" * 40),
            )
            assert (answer.success, "deeper than" in answer.message) == (False, True)
            assert not world.calls

    run(story)


def test_a_type_that_does_not_match_is_told():
    async def story():
        async with node() as (world, peer, aside):
            await aside(peer.token, "MS", "/rov/imu", "sensor_msgs/msg/Imu")  # as it is: nothing to tell
            await aside(peer.token, "MS", "/rov/imu", "sensor_msgs/msg/Imu", "RIHS01_" + "0" * 64)
            await aside(peer.token, "SC", "/world/pause", "std_srvs/srv/SetBool")
            await until(lambda: world.stats.details.get("refused") == {"type": 2})
            assert world.stats.peers == 1

    run(story)


def test_another_domain_does_not_hear():
    async def story():
        async with node(domain=5) as (world, peer, aside):
            heard = await aside(peer.hear, "/rov/imu", "sensor_msgs/msg/Imu")
            await until(lambda: "rov/imu" in world.subscriptions)
            peer.domain = 6
            other = await aside(peer.hear, "/rov/imu", "sensor_msgs/msg/Imu")
            world.put([sample(PORTS["rov/imu"])])
            await aside(heard.get, timeout=60)
            assert other.empty()

    run(story)


def test_other_ports_are_other_topics():
    async def story():
        async with node() as (world, peer, aside):
            world.set_ports([PORTS["rov/imu"]])
            end = time.monotonic() + PATIENCE_S
            while any("%rov%leak" in token for token in await aside(peer.graph)):
                assert time.monotonic() < end
            world.set_ports([PORTS["rov/imu"], PORTS["rov/leak"]])
            while not any("%rov%leak" in token for token in await aside(peer.graph)):
                assert time.monotonic() < end

    run(story)


def test_a_large_message_comes_whole():
    async def story():
        async with node() as (world, peer, aside):
            text = "std_msgs/Header header\nbool valid\nuint64 seq\nint64 count\nfloat64[] size\nstring name\nuint8[] picture"
            await aside(peer.types.register, "uwserver_msgs/msg/Plankton", text)
            heard = await aside(peer.hear, "/rov/strange", "uwserver_msgs/msg/Plankton")
            await until(lambda: "rov/strange" in world.subscriptions)
            picture = Buffer.of(np.arange(2 * 500_000, dtype=np.uint8).reshape(2, -1))
            world.put([sample(PORTS["rov/strange"], picture=picture)])
            said = await aside(heard.get, timeout=60)
            data = peer.types.from_cdr(said.payload.to_bytes(), "uwserver_msgs/msg/Plankton").picture
            assert data.tobytes() == picture.data

    run(story)


def test_an_action_of_a_client_of_ros():
    """As rcl_action: the goal is sent, its status and feedback are heard, its result is asked for at once and comes at its end."""

    async def story():
        async with node(made=flying()) as (world, peer, aside):
            action, below = "uwserver_msgs/action/Goto", "/rov/goto/_action/"
            feedback = await aside(peer.hear, below + "feedback", f"{action}_FeedbackMessage")
            uuid = peer.types.make("unique_identifier_msgs/msg/UUID", uuid=np.arange(16, dtype=np.uint8))
            goal = peer.types.make(f"{action}_Goal", speed=0.5)
            sent = await aside(peer.call, below + "send_goal", f"{action}_SendGoal", goal_id=uuid, goal=goal)
            assert sent.accepted
            status = await aside(peer.hear, below + "status", "action_msgs/msg/GoalStatusArray", latched=True)
            said = await aside(status.get, timeout=60)  # a late comer
            (told,) = peer.types.from_cdr(said.payload.to_bytes(), "action_msgs/msg/GoalStatusArray").status_list
            assert (told.status, told.goal_info.goal_id.uuid.tolist()) == (2, list(range(16)))
            (call,) = [call for call in world.calls if call.service == "rov/autopilot/goto"]
            asked = asyncio.ensure_future(aside(peer.call, below + "get_result", f"{action}_GetResult", goal_id=uuid))
            await asyncio.sleep(0.2)
            call.progress(0.5)
            call.finish(Reply(1, 1, {"distance_m": 0.1}))
            result = await asked
            assert (result.status, result.result.success) == (4, True)
            moved = await aside(feedback.get, timeout=60)
            assert peer.types.from_cdr(moved.payload.to_bytes(), f"{action}_FeedbackMessage").feedback.progress == 0.5
            tokens = {(e.kind, e.name): e for e in map(parsed_token, await aside(peer.graph)) if e is not None}
            assert tokens["SS", below + "cancel_goal"].type == "action_msgs::srv::dds_::CancelGoal_"
            assert tokens["MP", below + "feedback"].type == "uwserver_msgs::action::dds_::Goto_FeedbackMessage_"

    run(story)


def test_numbers_that_are_none_and_lists_of_any_length_change_nothing():
    async def story():
        async with node() as (world, peer, aside):
            kind, topic = "std_msgs/msg/Float64MultiArray", "/rov/thrusters/cmd"
            wrong = [np.full(3, np.nan), np.array([0.1, np.inf, 0.0]), np.zeros(0), np.zeros(1000), np.zeros(100_000)]
            for data in wrong:
                await aside(peer.say, topic, kind, data=data)
            await aside(peer.say, "/rov/cmd_depth", "std_msgs/msg/Float64", data=float("nan"))
            await until(lambda: sum(world.stats.details.get("refused", {}).values()) == 6)
            assert world.stats.details["refused"] == {"not_finite": 3, "bad_shape": 2, "message": 1}
            assert world.commands == []
            await aside(peer.say, topic, kind, data=np.zeros(3))
            await until(lambda: world.commands)

    run(story)
