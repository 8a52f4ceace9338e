"""The node on zenoh as a bridge sees it: plain keys, tokens of zenoh-bridge-ros2dds, requests without or with its attachment.

The other side is written from the bridge's source: docs/how-to/ros2.md says what was tried.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from adapter_rig import serving
from ros_rig import PORTS, flying, sample

from uwserver.ports import Reply

zenoh = pytest.importorskip("zenoh")

from uwserver_adapters.ros.messages import Types  # noqa: E402
from uwserver_adapters.ros2 import Ros2Adapter  # noqa: E402
from uwserver_adapters.ros2.config import Ros2Config  # noqa: E402
from uwserver_adapters.ros2.graph import (  # noqa: E402
    BEST_EFFORT,
    LATCHED,
    RELIABLE,
    BridgeNames,
    Endpoint,
)

NAMES = BridgeNames("aac3178e")
HASH = "RIHS01_7d9a00ff"


def test_words_are_those_of_the_bridge():
    assert NAMES.key("/rov/imu", "sensor_msgs/msg/Imu", HASH) == "rov/imu"
    assert NAMES.node_token() == "@/aac3178e/@ros2_lv"
    token = NAMES.token(7, "MP", "/rov/imu", "sensor_msgs/msg/Imu", HASH, RELIABLE)
    assert token == "@/aac3178e/@ros2_lv/MP/rov§imu/sensor_msgs§msg§Imu/:1:0:0,10:typehash=RIHS01_7d9a00ff;"
    assert NAMES.token(7, "MP", "/m", "a/msg/B", "TypeHashNotSupported", LATCHED).endswith("/m/a§msg§B/:1:1:0,1")
    assert NAMES.token(7, "MS", "/m", "a/msg/B", "", BEST_EFFORT) == "@/aac3178e/@ros2_lv/MS/m/a§msg§B/:0:0:0,1"
    assert NAMES.token(8, "SS", "/world/pause", "std_srvs/srv/Trigger", HASH, RELIABLE) == (
        "@/aac3178e/@ros2_lv/SS/world§pause/std_srvs§srv§Trigger"
    )


def test_an_action_has_one_token():
    told = [
        NAMES.token(1, kind, f"/rov/goto/_action/{part}", type_name, HASH, RELIABLE)
        for kind, part, type_name in (
            ("SS", "send_goal", "uwserver_msgs/action/Goto_SendGoal"), ("SS", "get_result", "uwserver_msgs/action/Goto_GetResult"),
            ("SS", "cancel_goal", "action_msgs/srv/CancelGoal"), ("MP", "feedback", "uwserver_msgs/action/Goto_FeedbackMessage"),
            ("MP", "status", "action_msgs/msg/GoalStatusArray"),
        )
    ]  # fmt: skip
    assert told == ["@/aac3178e/@ros2_lv/AS/rov§goto/uwserver_msgs§action§Goto", "", "", "", ""]


def test_tokens_of_others_are_read():
    token = NAMES.token(7, "MP", "/rov/imu", "sensor_msgs/msg/Imu", HASH, RELIABLE)
    assert NAMES.parsed(token) == Endpoint("aac3178e", "MP", "a bridge", "/rov/imu", "sensor_msgs/msg/Imu", "")
    for none in (NAMES.node_token(), "", "@/a/@ros2_lv/XX/a/b", "@/a/b/MP/a/b"):
        assert NAMES.parsed(none) is None


class Bridge:
    """What a bridge does beside the loop; its calls block."""

    def __init__(self, address):
        config = zenoh.Config()
        settings = {
            "mode": '"client"', "connect/endpoints": f'["{address}"]', "scouting/multicast/enabled": "false",
            "transport/shared_memory/enabled": "false",
        }  # fmt: skip
        for path, value in settings.items():
            config.insert_json5(path, value)
        self.session, self.types, self.held = zenoh.open(config), Types(), []

    def graph(self):
        return [str(reply.ok.key_expr) for reply in self.session.liveliness().get("@/*/@ros2_lv/**", timeout=60)]

    def announce(self, rest):
        self.held.append(self.session.liveliness().declare_token(f"@/{self.session.zid()}/@ros2_lv/{rest}"))

    def hear(self, key, latched=False):
        heard = queue.Queue()
        if latched:
            from zenoh import ext

            made = ext.declare_advanced_subscriber(
                self.session, key, heard.put, history=ext.HistoryConfig(detect_late_publishers=True)
            )
        else:
            made = self.session.declare_subscriber(key, heard.put)
        self.held.append(made)
        return heard

    def ask(self, key, kind, attachment=None, **fields):
        data = self.types.cdr(self.types.make(f"{kind}_Request", **fields)) if fields or attachment else None
        (reply,) = self.session.get(key, payload=data, attachment=attachment, timeout=60)
        return self.types.from_cdr(reply.ok.payload.to_bytes(), f"{kind}_Response")

    def say(self, key, kind, **fields):
        data = self.types.cdr(self.types.make(kind, **fields))
        self.session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)  # else a slow reader loses it


@contextlib.asynccontextmanager
async def bridged(**config):
    made = flying()
    at_once = {"scouting/delay": 1}  # not after half a second in which others are looked for
    table = Ros2Config(transport="bridge", listen=("tcp/127.0.0.1:0",), truth=True, config=at_once, **config)
    async with serving(Ros2Adapter(table, made)):
        loop, pool = asyncio.get_running_loop(), ThreadPoolExecutor(1)

        async def aside(work, *args, **more):
            return await loop.run_in_executor(pool, lambda: work(*args, **more))

        peer = await aside(Bridge, made.stats.address)
        try:
            yield made, peer, aside
        finally:
            await aside(peer.session.close)
            pool.shutdown()


def run(story):
    asyncio.run(asyncio.wait_for(story(), 120))


async def until(condition):
    end = asyncio.get_running_loop().time() + 60
    while not condition():
        assert asyncio.get_running_loop().time() < end, "it does not come"
        await asyncio.sleep(0.02)


def test_topics_and_commands_pass_and_late_comers_get_what_is_latched():
    async def story():
        async with bridged() as (world, peer, aside):
            tokens = {token.split("/", 3)[3] for token in await aside(peer.graph) if token.count("/") > 2}
            hashes = {name: peer.types.hash(name) for name in ("sensor_msgs/msg/Imu", "std_msgs/msg/Float64MultiArray")}
            imu, numbers = hashes.values()
            assert {
                f"MP/rov§imu/sensor_msgs§msg§Imu/:1:0:0,10:typehash={imu};",
                f"MS/rov§thrusters§cmd/std_msgs§msg§Float64MultiArray/:0:0:0,1:typehash={numbers};",
                "SS/world§pause/std_srvs§srv§Trigger", "AS/rov§goto/uwserver_msgs§action§Goto",
            } <= tokens  # fmt: skip
            assert not [token for token in tokens if "_action" in token]
            static = await aside(peer.hear, "tf_static", latched=True)
            said = await aside(static.get, timeout=60)
            transforms = peer.types.from_cdr(said.payload.to_bytes(), "tf2_msgs/msg/TFMessage").transforms
            assert [one.child_frame_id for one in transforms] == ["rov/odom"]
            heard = await aside(peer.hear, "rov/imu")
            await until(lambda: "rov/imu" in world.subscriptions)
            world.put([sample(PORTS["rov/imu"])])
            first = await aside(heard.get, timeout=60)
            assert peer.types.from_cdr(first.payload.to_bytes(), "sensor_msgs/msg/Imu").linear_acceleration.z == 9.81
            await aside(peer.say, "rov/thrusters/cmd", "std_msgs/msg/Float64MultiArray", data=np.array([0.1, 0.2, 0.3]))
            await until(lambda: world.commands)
            assert world.commands[0].value == ((0.1, 0.2, 0.3),)

    run(story)


def test_services_answer_bridges_and_plain_clients():
    async def story():
        async with bridged() as (world, peer, aside):
            kind = "std_srvs/srv/Trigger"
            request_id = bytes(range(16)) + b"\1"
            assert (await aside(peer.ask, "world/pause", kind, attachment=request_id)).success
            assert (await aside(peer.ask, "world/pause", kind)).success  # without payload
            step = "uwserver_msgs/srv/Step"
            peer.types.register_service(step, "int64[<=1] n", "bool success\nstring message\nstring result")
            assert (await aside(peer.ask, "world/step", step, n=np.array([5]))).success
            assert [call.args for call in world.calls if call.service == "world/step"] == [{"n": 5}]

    run(story)


def test_an_action_passes():
    async def story():
        async with bridged() as (world, peer, aside):
            action, below = "uwserver_msgs/action/Goto", "rov/goto/_action/"
            feedback = await aside(peer.hear, below + "feedback")
            uuid = peer.types.make("unique_identifier_msgs/msg/UUID", uuid=np.ones(16, np.uint8))
            sent = await aside(peer.ask, below + "send_goal", f"{action}_SendGoal", goal_id=uuid)
            assert sent.accepted
            (call,) = [call for call in world.calls if call.service == "rov/autopilot/goto"]
            await until(lambda: _fed(call, feedback))
            call.finish(Reply(1, 1, {}))
            assert (await aside(peer.ask, below + "get_result", f"{action}_GetResult", goal_id=uuid)).status == 4

    run(story)


def _fed(call, feedback):
    """Progress is told once somebody is known to listen."""
    call.progress(0.5)
    return not feedback.empty()


def test_another_type_of_the_same_name_is_told():
    async def story():
        async with bridged() as (world, peer, aside):
            await aside(peer.announce, "MS/rov§imu/std_msgs§msg§String/:0:0:0,1")
            await until(lambda: world.stats.details.get("refused"))
            assert world.stats.details["refused"] == {"type": 1}
            assert world.stats.peers == 1

    run(story)
