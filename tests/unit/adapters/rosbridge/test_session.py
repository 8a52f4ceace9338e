"""A client of rosbridge against the adapter, on loopback: every operation, and what is refused."""

from __future__ import annotations

import asyncio
import json
import struct

import pytest
import websockets
from adapter_rig import serving
from kernel_buffers import keep_small, slow_reader
from ros_rig import PORTS, T_NS, context, flying, sample
from rosbridge_rig import Client, bridge, run
from uwserver_adapters.ros.messages import Types
from uwserver_adapters.rosbridge import RosbridgeAdapter, subscriptions
from uwserver_adapters.rosbridge.config import RosbridgeConfig

from uwserver.ports import Argument, Event, Refused, Reply, Sample, Service

IMU = PORTS["rov/imu"]


def later(t_ns, port=IMU):
    base = sample(port)
    return Sample(base.port, base.seq, t_ns, t_ns, True, base.value)


def test_a_topic_is_heard_once_subscribed_and_not_after():
    async def story():
        async with bridge() as (world, client):
            assert world.subscriptions == set()  # nothing is made for nobody
            await client.say(op="subscribe", id="a", topic="/rov/imu", type="sensor_msgs/Imu")
            await client.say(op="subscribe", id="b", topic="rov/imu/", type="sensor_msgs/msg/Imu")
            await client.settle()
            assert world.subscriptions == {"rov/imu"}
            world.put([sample(IMU)])
            heard = await client.hear()
            assert (heard["op"], heard["topic"]) == ("publish", "/rov/imu")
            assert heard["msg"]["linear_acceleration"] == {"x": 0.1, "y": -0.2, "z": 9.81}
            stamp = heard["msg"]["header"]["stamp"]
            assert stamp["sec"] * 10**9 + stamp["nanosec"] == world.world.epoch_ns + T_NS
            await client.say(op="unsubscribe", id="a", topic="/rov/imu")
            await client.settle()
            assert world.subscriptions == {"rov/imu"}
            await client.say(op="unsubscribe", id="b", topic="/rov/imu")
            await client.settle()
            assert world.subscriptions == set()

    run(story)


def test_forms_that_clients_ask_for():
    async def story():
        async with bridge(3) as (world, json_client, cbor_client, raw_client):
            for client, form in ((json_client, "png"), (cbor_client, "cbor"), (raw_client, "cbor-raw")):
                await client.say(op="subscribe", topic="/rov/lasers", compression=form)
                await client.settle()
            world.put([sample(PORTS["rov/lasers"])])
            assert (await json_client.hear())["op"] == "png"
            tag, ranges = (await cbor_client.hear())["msg"]["ranges"]
            assert (tag, ranges[0]) == (85, 3.0)
            raw = (await raw_client.hear())["msg"]
            assert Types().from_cdr(raw["bytes"], "sensor_msgs/msg/LaserScan").ranges[0] == 3.0
            assert raw["secs"] == (world.world.epoch_ns + T_NS) // 10**9

    run(story)


def test_a_message_is_encoded_once_for_all():
    async def story():
        async with bridge(5) as (world, *clients):
            for client in clients:
                await client.say(op="subscribe", topic="/rov/imu")
                await client.settle()
            for k in range(10):
                world.put([later(k)])
            for client in clients:
                for _ in range(10):
                    await client.hear()
            assert world.stats.encoded == 10
            assert world.stats.samples_sent == 50

    run(story)


def test_throttled_messages_are_dropped_or_wait():
    async def story():
        async with bridge(2) as (world, drops, waits):
            await drops.say(op="subscribe", topic="/rov/imu", throttle_rate=60_000)
            await waits.say(op="subscribe", topic="/rov/imu", throttle_rate=20, queue_length=3)
            await drops.settle()
            await waits.settle()
            for k in range(10):
                world.put([later(k * 10**9)])
            seconds = [
                (await waits.hear())["msg"]["header"]["stamp"]["sec"] - world.world.epoch_ns // 10**9 for _ in range(4)
            ]
            assert seconds == [0, 7, 8, 9]  # the first, then the newest three
            assert (await drops.hear())["msg"]["header"]["stamp"]["sec"] == world.world.epoch_ns // 10**9
            assert (await drops.call("/rosapi/get_ros_version"))["op"] == "service_response"  # and nothing between

    run(story)


def test_long_messages_come_in_pieces():
    async def story():
        async with bridge() as (world, client):
            await client.say(op="subscribe", topic="/chat", fragment_size=200)
            await client.say(op="publish", topic="/chat", type="std_msgs/String", msg={"data": "x" * 3000})
            while (first := await client.hear())["op"] != "fragment":
                pass
            assert (first["total"], len(first["data"])) == (3, 1024)  # smaller pieces cost more than they hold
            pieces = [first]
            while len(pieces) < pieces[0]["total"]:
                pieces.append(await client.hear())
            assert json.loads("".join(piece["data"] for piece in pieces))["topic"] == "/chat"
            text = json.dumps({"op": "publish", "topic": "/rov/fin/cmd", "msg": {"data": 0.25}})
            for num in (1, 0):
                data = text[30 * num : 30 * (num + 1) if num == 0 else None]
                await client.say(op="fragment", id="x", num=num, total=2, data=data)
            await client.settle()
            assert world.commands[-1].value == ((0.25,),)

    run(story)


def test_latched_topics_greet_late_comers():
    async def story():
        async with bridge() as (_, client):
            await client.say(op="subscribe", topic="/tf_static")
            transforms = (await client.hear())["msg"]["transforms"]
            assert [one["child_frame_id"] for one in transforms] == ["rov/odom"]

    run(story)


def test_the_clock_ticks_in_simulated_time():
    async def story():
        async with bridge(clock_hz=10) as (world, client):
            await client.say(op="subscribe", topic="/clock")
            await client.settle()
            assert len(world.subscriptions) == 1
            (path,) = world.subscriptions
            for k in range(100):  # 4 ms a tick: 0.4 s
                world.put([later(k * 4_000_000, PORTS[path])])
            nanoseconds = [(await client.hear())["msg"]["clock"]["nanosec"] for _ in range(4)]
            assert nanoseconds == [0, 100_000_000, 200_000_000, 300_000_000]
            world.say(Event("reset", 0, 0, "again"))
            world.put([later(0, PORTS[path])])
            assert (await client.hear())["msg"]["clock"]["nanosec"] == 0

    run(story)


def test_commands_reach_their_actuator_and_wrong_ones_are_told():
    async def story():
        async with bridge() as (world, client):
            await client.say(op="advertise", topic="/rov/cmd_vel", type="geometry_msgs/Twist")
            await client.say(op="publish", topic="/rov/cmd_vel", msg={"linear": {"x": 1.0}})
            await client.settle()
            assert world.commands[-1].port == "rov/autopilot/velocity"
            before = len(world.commands)
            for message, text in (
                ({"topic": "/rov/thrusters/cmd", "msg": {"data": [5.0, 0.0, 0.0]}}, "at most 1"),
                ({"topic": "/rov/thrusters/cmd", "msg": {"data": [None, 0.0, 0.0]}}, "finite"),
                ({"topic": "/rov/cmd_vel", "msg": {"linear": {"q": 1}}}, "has no field 'q'"),
                ({"topic": "/rov/cmd_vell", "msg": {}}, 'did you mean "/rov/cmd_vel"'),
                ({"topic": "/rov/imu", "msg": {}, "type": "sensor_msgs/Imu"}, "the simulator alone"),
            ):
                await client.say(op="publish", id=7, **message)
                told = await client.hear()
                assert (told["op"], told["level"], told["id"]) == ("status", "error", 7)
                assert text in told["msg"]
            assert len(world.commands) == before

    run(story)


def test_a_refused_command_and_a_time_out_are_not_held():
    async def story():
        async with bridge() as (world, client):

            async def say(topic, data):
                await client.say(op="publish", topic=f"/rov/thrusters/{topic}", msg={"data": data})
                await client.settle()
                return world.commands[-1].value[0]

            assert await say("cmd", [0.1, 0.2, 0.3]) == (0.1, 0.2, 0.3)
            await say("t1/cmd", 5.0)  # refused
            assert await say("t2/cmd", 0.5) == (0.1, 0.5, 0.3)
            world.say(Event("watchdog", 1, 1, 'no command for "rov/thrusters" in 1 s: it went to neutral'))
            assert await say("t2/cmd", 0.25) == (0.0, 0.25, 0.0)

    run(story)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        ({"op": "subscribe"}, 'needs a "topic"'),
        ({"op": "subscribe", "topic": "/rov/imu", "type": "nav_msgs/Odometry"}, "is of type sensor_msgs/msg/Imu"),
        ({"op": "subscribe", "topic": "/a", "compression": "zip"}, "compression is one of"),
        ({"op": "subscribe", "topic": "/a", "throttle_rate": -1}, "throttle_rate must be"),
        ({"op": "subscribe", "topic": "/a", "throttle_rate": "fast"}, "throttle_rate must be"),
        ({"op": "subscribe", "topic": "/" + "a" * 300}, "256 characters"),
        ({"op": "advertise", "topic": "/a"}, 'needs a "type"'),
        ({"op": "advertise", "topic": "/rov/cmd_vel", "type": "std_msgs/String"}, "is of type geometry_msgs/msg/Twist"),
        ({"op": "set_level", "level": "loud"}, "level is one of"),
        ({"op": "subscrib"}, 'did you mean "subscribe"'),
        ({"op": ["x"]}, "no operation"),
        ({}, "no operation"),
        ({"op": "auth"}, "token in the address"),
        ({"op": "service_response", "id": "x"}, "no call of this id"),
        ({"op": "advertise_service", "service": "/world/pause", "type": "x/Y"}, "a service of the simulator"),
        ({"op": "action_result", "action": "/dock", "id": "x", "values": {}}, "action_result: no goal of this id"),
        ({"op": "action_feedback", "action": "/dock", "id": "x"}, "action_feedback: no goal of this id"),
        ({"op": "advertise_action", "action": "/dock"}, 'needs a "type"'),
        ({"op": "fragment", "num": 0, "total": 1, "data": '{"op":"fragment"}'}, "fragments of fragments"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told(message, text):
    async def story():
        async with bridge() as (world, client):
            await client.say(**message)
            told = await client.hear()
            assert text in told["msg"]
            assert world.stats.errors == 1

    run(story)


def test_services():
    async def story():
        async with bridge() as (world, client):
            assert (await client.call("/world/pause", id=5)) == {
                "op": "service_response", "service": "/world/pause", "id": 5, "result": True,
                "values": {"success": True, "message": ""},
            }  # fmt: skip
            answer = await client.call("world/step", {"n": [7]})
            assert answer["values"]["success"]
            assert world.calls[-1].args == {"n": 7}
            answer = await client.call("/world/step", [[9]])  # by place
            assert world.calls[-1].args == {"n": 9}
            answer = await client.call("/world/step", {"m": 1})
            assert (answer["result"], "has no field 'm'" in answer["values"]) == (False, True)
            answer = await client.call("/world/stepp", compression="cbor")
            assert (answer["result"], 'did you mean "/world/step"' in answer["values"]) == (False, True)

            def refuse(_):
                raise Refused("busy", "not now", "world/pause")

            world.scripts["world/pause"] = refuse
            answer = await client.call("/world/pause")
            assert (answer["result"], answer["values"]) == (True, {"success": False, "message": "not now"})

    run(story)


def test_calls_by_the_hundred_are_answered():
    async def story():
        async with bridge() as (_, client):
            total, wave = 1500, 500
            seen = set()
            for begin in range(0, total, wave):
                for k in range(begin, begin + wave):
                    await client.say(op="call_service", id=k, service="/world/echo", args={"value": [str(k)]})
                for _ in range(wave):
                    answer = await client.hear()
                    assert json.loads(answer["values"]["result"]) == answer["id"]
                    seen.add(answer["id"])
            assert len(seen) == total

    run(story)


def test_clients_serve_each_other():
    async def story():
        async with bridge(2) as (_, asks, serves):
            await serves.say(op="advertise_service", service="/add", type="example_interfaces/AddTwoInts")
            await serves.settle()
            await asks.say(op="call_service", id="q", service="/add", args={"a": 1, "b": 2})
            call = await serves.hear()
            assert (call["op"], call["args"]) == ("call_service", {"a": 1, "b": 2})
            await serves.say(op="service_response", id=call["id"], service="/add", values={"sum": 3}, result=True)
            assert (await asks.hear()) == {
                "op": "service_response", "service": "/add", "id": "q", "result": True, "values": {"sum": 3}
            }  # fmt: skip
            await asks.say(op="call_service", id="r", service="/add", args={})
            await serves.hear()
            await serves.socket.close()
            answer = await asks.hear()
            assert (answer["result"], "has gone" in answer["values"]) == (False, True)
            assert not (await asks.call("/add"))["result"]

    run(story)


def test_clients_talk_to_each_other():
    async def story():
        async with bridge(2) as (_, speaks, hears):
            await speaks.say(op="advertise", topic="/chat", type="std_msgs/String")
            await speaks.settle()
            await hears.say(op="subscribe", topic="/chat")
            await hears.settle()
            await speaks.say(op="publish", topic="/chat", msg={"data": "hello"})
            assert (await hears.hear())["msg"] == {"data": "hello"}
            await speaks.say(op="publish", topic="/chat", msg={"data": 5})
            assert "must be a text" in (await speaks.hear())["msg"]
            assert (await hears.call("/rosapi/topic_type", {"topic": "/chat"}))["values"] == {
                "type": "std_msgs/msg/String"
            }
            await speaks.socket.close()
            while (await hears.call("/rosapi/topic_type", {"topic": "/chat"}))["values"]["type"]:
                await asyncio.sleep(0.01)

    run(story)


def test_status_messages_as_loud_as_asked():
    async def story():
        async with bridge() as (_, client):
            await client.say(op="subscribe", topic="/nobody")
            await client.settle()  # a warning, which is not told
            await client.say(op="set_level", level="warning")
            await client.say(op="subscribe", topic="/rov/imuu", id="w")
            told = await client.hear()
            assert (told["level"], 'did you mean "/rov/imu"' in told["msg"]) == ("warning", True)
            await client.say(op="set_level", level="none")
            await client.say(op="nonsense")
            assert (await client.call("/world/pause"))["result"]

    run(story)


def test_rosapi_tells_what_there_is():
    async def story():
        async with bridge() as (world, client):

            async def ask(name, /, **args):
                answer = await client.call(f"/rosapi/{name}", args)
                assert answer["result"], answer
                return answer["values"]

            topics = await ask("topics")
            assert (
                dict(zip(topics["topics"], topics["types"], strict=True))["/rov/cmd_vel"] == "geometry_msgs/msg/Twist"
            )
            raw = await ask("topics_and_raw_types")
            text = dict(zip(raw["topics"], raw["typedefs_full_text"], strict=True))["/rov/dvl"]
            assert "MSG: geometry_msgs/Vector3" in text
            assert (await ask("topic_type", topic="rov/imu")) == {"type": "sensor_msgs/msg/Imu"}
            assert (await ask("topics_for_type", type="sensor_msgs/Imu"))["topics"] == ["/rov/ahrs", "/rov/imu"]
            assert "/world/pause" in (await ask("services"))["services"]
            assert (await ask("service_type", service="/world/pause")) == {"type": "std_srvs/srv/Trigger"}
            assert "/world/pause" in (await ask("services_for_type", type="std_srvs/Trigger"))["services"]
            assert (await ask("nodes")) == {"nodes": ["/uwserver"]}
            assert "/rov/imu" in (await ask("node_details", node="/uwserver"))["publishing"]
            assert (await ask("publishers", topic="/rov/imu")) == {"publishers": ["/uwserver"]}
            details = (await ask("message_details", type="sensor_msgs/Imu"))["typedefs"]
            assert details[0]["fieldnames"][:2] == ["header", "orientation"]
            assert details[0]["fieldarraylen"][2] == 9
            assert details[1]["type"] == "std_msgs/msg/Header"
            request = (await ask("service_request_details", type="uwserver_msgs/srv/Step"))["typedefs"]
            assert request[0]["fieldnames"] == ["n"]
            assert (await ask("get_ros_version")) == {"version": 2, "distro": "jazzy"}
            assert (await ask("get_time"))["time"]["sec"] == world.world.epoch_ns // 10**9
            assert (await ask("get_param", name="/x"))["successful"] is False
            for name in (
                "get_param_names",
                "has_param",
                "action_servers",
                "interfaces",
                "subscribers",
                "service_node",
                "search_param",
            ):
                await ask(name)
            bad = await client.call("/rosapi/message_details", {"type": "a/B"})
            assert (bad["result"], "no message type" in bad["values"]) == (False, True)

    run(story)


def test_clients_of_ros1_get_its_words():
    async def story():
        async with bridge(ros_distro="noetic") as (world, client):
            await client.say(op="subscribe", topic="/rov/imu", type="sensor_msgs/Imu")
            await client.settle()
            world.put([sample(IMU)])
            header = (await client.hear())["msg"]["header"]
            assert set(header) == {"seq", "stamp", "frame_id"}
            assert set(header["stamp"]) == {"secs", "nsecs"}
            assert (await client.call("/rosapi/topic_type", {"topic": "/rov/imu"}))["values"] == {
                "type": "sensor_msgs/Imu"
            }

    run(story)


def test_other_ports_are_other_topics():
    async def story():
        async with bridge() as (world, client):
            await client.say(op="subscribe", topic="/rov/leak")
            await client.settle()
            assert world.subscriptions == {"rov/leak"}
            world.set_ports([IMU])
            while "/rov/leak" in (await client.call("/rosapi/topics"))["values"]["topics"]:
                await asyncio.sleep(0.01)
            assert world.subscriptions == set()
            world.set_ports([IMU, PORTS["rov/leak"]])
            while world.subscriptions != {"rov/leak"}:  # it still listens
                await asyncio.sleep(0.01)

    run(story)


# -- who may -------------------------------------------------------------------------------------------------------------------------------


async def _opened(address, **options):
    try:
        async with websockets.connect(address, **options):
            return 101
    except websockets.InvalidStatus as refused:
        return refused.response.status_code


def test_pages_of_strangers_and_foreign_names_are_refused():
    async def story():
        made = context()
        async with serving(RosbridgeAdapter(RosbridgeConfig(port=0, allowed_origins=("https://ok.example",)), made)):
            address = made.stats.address
            port = address.rpartition(":")[2]
            assert await _opened(address) == 101
            assert await _opened(address, origin="https://evil.example") == 403
            assert await _opened(address, origin="https://ok.example") == 101
            sock_host = {"host": "127.0.0.1", "port": int(port)}
            assert await _opened(f"ws://rebound.example:{port}", **sock_host) == 403
            assert await _opened(f"ws://localhost:{port}", **sock_host) == 101
            assert made.stats.details["refused"] == {"origin": 1, "host": 1}

    run(story)


def test_a_token_is_asked_for():
    async def story():
        made = context()
        async with serving(RosbridgeAdapter(RosbridgeConfig(port=0, token="secret"), made)):
            address = made.stats.address
            assert await _opened(address) == 403
            assert await _opened(address + "/?token=wrong") == 403
            assert await _opened(address + "/?token=secret") == 101
            assert await _opened(address, additional_headers={"Authorization": "Bearer secret"}) == 101
            for _ in range(20):
                await _opened(address + "/?token=wrong")
            assert await _opened(address + "/?token=secret") == 403  # locked out for a while

    run(story)


def test_a_token_is_made_where_others_reach_it(monkeypatch):
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)

    async def story():
        assert RosbridgeAdapter(RosbridgeConfig(bind="0.0.0.0"), context()).token is not None
        assert RosbridgeAdapter(RosbridgeConfig(), context()).token is None

    run(story)


# -- hostile input --------------------------------------------------------------------------------------------------------------------------


def test_lines_of_chance_break_nothing():
    import numpy as np

    rng = np.random.default_rng(5)
    words = [
        '{"op":"subscribe","topic":"/rov/imu"', '"id":1', "}", "{", "[", "]", '"op":"publish"', '"topic":"/rov/thrusters/cmd"', '"msg":{"data":',
        "1e999", "NaN", "null", "-1", '"\\ud800"', '"args":[[[]]]', '"service":"/world/step"', '"op":"call_service"',
        '"op":"send_action_goal"', '"op":"cancel_action_goal"', '"action":"/uwserver/simulate_steps"', '"id":7', '"type":5', ",", ":", "\x00",
        '"compression":"png"', '"fragment_size":1', '"throttle_rate":1e300', '"queue_length":-0.5',
    ]  # fmt: skip

    async def story():
        async with bridge() as (world, client):
            await client.say(op="set_level", level="none")
            for _ in range(20):
                for _ in range(100):
                    await client.socket.send("".join(rng.choice(words, rng.integers(1, 9))))
                await client.call("/rosapi/get_ros_version", id="settle")
            assert world.stats.peers == 1

    run(story)


def test_hundreds_of_subscriptions_are_bounded():
    async def story():
        async with bridge(max_subscriptions=50) as (_, client):
            await client.say(op="set_level", level="error")
            for k in range(60):
                await client.say(op="subscribe", topic=f"/t{k}")
            told = [await client.hear() for _ in range(10)]
            assert all("raise max_subscriptions" in one["msg"] for one in told)
            for k in range(60):
                await client.say(op="advertise", topic=f"/u{k}", type="std_msgs/String")
            assert "raise max_subscriptions" in (await client.hear())["msg"]

    run(story)


def test_what_is_kept_of_a_client_is_short():
    long = "x" * 300

    async def story():
        async with bridge(max_subscriptions=5) as (_, client):
            for message, text in (
                ({"op": "subscribe", "topic": "/a", "id": long}, "an id has at most 256"),
                ({"op": "advertise", "topic": "/a", "type": long}, "a type has at most 256"),
                ({"op": "publish", "topic": "/a", "type": long, "msg": {}}, "a type has at most 256"),
                ({"op": "advertise_service", "service": long, "type": "x/Y"}, "a service has at most 256"),
                ({"op": "advertise_service", "service": "/a", "type": long}, "of at most 256"),
            ):
                await client.say(**message)
                assert text in (await client.hear())["msg"]
            await client.say(op="unsubscribe", topic="/a")
            for op, more in (("subscribe", {}), ("advertise", {"type": "std_msgs/String"})):
                for k in range(7):  # of two topics: all of a client's count
                    await client.say(op=op, topic=f"/{k % 2}", id=str(k), **more)
                assert ["raise max_subscriptions" in (await client.hear())["msg"] for _ in range(2)] == [True, True]
                await client.say(op=f"un{op}", topic="/0", id="0")
                await client.say(op=op, topic="/1", id="new", **more)  # has the place of that one
                await client.settle()

    run(story)


def test_whole_numbers_of_any_size_pass():
    async def story():
        async with bridge(3) as (_, speaks, binary, hears):
            for client, form in ((binary, "cbor"), (hears, "none")):
                await client.say(op="subscribe", topic="/x", compression=form)
                await client.settle()
            await speaks.say(
                op="publish", topic="/x", type="some_msgs/Own", msg={"n": [1 << 70, -(1 << 70)]}, id=1 << 70
            )
            assert [(await client.hear())["msg"]["n"] for client in (binary, hears)] == [[1 << 70, -(1 << 70)]] * 2

    run(story)


def test_messages_of_clients_are_encoded_once_for_all(monkeypatch):
    made = []
    published = subscriptions.published
    monkeypatch.setattr(subscriptions, "published", lambda *args: made.append(args[2]) or published(*args))

    async def story():
        async with bridge(4) as (_, *clients):
            for client in clients:
                await client.say(op="subscribe", topic="/x", compression="png")
                await client.settle()
            await clients[0].say(op="publish", topic="/x", type="some_msgs/Own", msg={"data": "y" * 100})
            for client in clients:
                assert (await client.hear())["op"] == "png"
            assert made == ["png"]

    run(story)


def test_what_waits_for_a_client_is_bounded_in_bytes():
    async def story():
        async with bridge(2, queue_bytes=5000) as (_, speaks, waits):
            for topic in ("/x", "/y"):
                await waits.say(op="subscribe", topic=topic, throttle_rate=300, queue_length=100)
            await waits.settle()
            for topic in ("/x", "/y"):
                for k in range(10):
                    await speaks.say(op="publish", topic=topic, type="some_msgs/Own", msg={"k": k, "data": "y" * 900})
            await speaks.settle()
            heard = [(one["topic"], one["msg"]["k"]) for one in [await waits.hear() for _ in range(7)]]
            assert sorted(heard) == [("/x", 0), *(("/x", k) for k in range(5, 10)), ("/y", 0)]

    run(story)


def test_who_does_not_read_loses_samples_and_holds_up_nobody(monkeypatch):
    keep_small(monkeypatch)

    async def story():
        made = context()
        config = RosbridgeConfig(port=0, queue_samples=50, queue_bytes=1 << 20)
        async with serving(RosbridgeAdapter(config, made)):
            host, _, port = made.stats.address.removeprefix("ws://").rpartition(":")
            reader, writer = await asyncio.open_connection(sock=slow_reader(host, int(port)), limit=1024)
            writer.write(
                f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
            )
            await reader.readuntil(b"\r\n\r\n")
            body = b'{"op":"subscribe","topic":"/rov/imu"}'
            writer.write(b"\x81" + struct.pack(">B", 0x80 | len(body)) + bytes(4) + body)
            while not made.subscriptions:
                await asyncio.sleep(0.01)
            async with websockets.connect(made.stats.address) as other:
                client = Client(other)
                await client.say(op="subscribe", topic="/rov/imu")
                await client.settle()
                count = 0
                while made.stats.dropped < 300:  # once the kernel's buffers are full
                    for _ in range(20):
                        made.put([later(count)])
                        count += 1
                    for _ in range(20):
                        await client.hear()

            writer.close()

    run(story)


# -- actions --------------------------------------------------------------------------------------------------------------------------------


def running(world):
    return [call for call in world.calls if call.service == "rov/autopilot/goto" and not call.is_done]


def test_a_goal_tells_where_it_is_and_how_it_ends():
    async def story():
        async with bridge(made=flying()) as (world, client):
            goal = {"op": "send_action_goal", "action": "rov/goto", "args": {"speed": 0.5}}
            await client.say(**goal, id="one", action_type="uwserver_msgs/Goto", feedback=True)
            await client.say(**goal, id=2)
            await client.settle()
            one, two = running(world)
            assert one.args["speed_mps"] == 0.5
            one.progress(0.25)
            two.progress(0.25)  # which this goal did not ask for
            one.finish(Reply(1, 1, {"distance_m": 0.5}))
            two.finish(Reply(1, 1, fault=Refused("denied", "not armed").fault))
            about = {"action": "/rov/goto", "id": "one"}
            assert await client.hear() == {"op": "action_feedback", **about, "values": {"progress": 0.25}}
            values = {"success": True, "message": "", "distance": 0.5}
            assert await client.hear() == {
                "op": "action_result",
                **about,
                "values": values,
                "status": 4,
                "result": True,
            }
            told = await client.hear()
            assert (told["id"], told["status"], told["values"]["message"]) == (2, 6, "not armed")
            assert world.stats.details["refused"] == {"goal": 1}

    run(story)


def test_a_goal_is_cancelled_and_those_of_a_client_that_leaves():
    async def story():
        async with bridge(2, made=flying()) as (world, client, other):
            await client.say(op="send_action_goal", action="/rov/goto", id="a")
            await other.say(op="send_action_goal", action="/rov/goto", id="a")
            await client.settle()
            await other.settle()
            assert len(running(world)) == 2
            await client.say(op="cancel_action_goal", action="/rov/goto", id="a")
            told = await client.hear()
            assert (told["op"], told["id"], told["status"], told["result"]) == ("action_result", "a", 5, True)
            await client.say(op="cancel_action_goal", action="/rov/goto", id="a")
            assert "no goal of this id" in (await client.hear())["msg"]
            assert len(running(world)) == 1
            await other.socket.close()
            await client.settle()
            while running(world):
                await asyncio.sleep(0.01)

    run(story)


@pytest.mark.parametrize(
    ("message", "word"),
    [
        ({"action": "/rov/got", "id": "x"}, 'did you mean "/rov/goto"'),
        ({"action": "/rov/goto"}, "needs an id"),
        ({"id": "x"}, 'needs an "action"'),
        ({"action": "a" * 300, "id": "x"}, "at most 256"),
        ({"action": "/rov/goto", "id": "x", "action_type": "uwserver_msgs/action/Mission"}, "is of type"),
        ({"action": "/rov/goto", "id": "x", "args": {"speed": "fast"}}, "speed must be a number"),
        ({"action": "/rov/goto", "id": "x", "args": {"speed": None}}, "speed_mps"),
        ({"action": "/rov/goto", "id": "x", "args": 7}, "must be a map"),
        ({"action": "/rov/mission", "id": "x", "args": {"items": "[["}}, "items is no JSON"),
    ],
)
def test_a_goal_that_is_not_taken_has_a_result_that_says_why(message, word):
    async def story():
        async with bridge(made=flying()) as (world, client):
            await client.say(op="send_action_goal", **message)
            told = await client.hear()
            assert (told["op"], told["result"], told["status"], told.get("id")) == (
                "action_result",
                False,
                0,
                message.get("id"),
            )
            assert word in told["values"]
            assert not [call for call in world.calls if call.service.startswith("rov/autopilot/")]

    run(story)


def test_rosapi_tells_actions():
    async def story():
        async with bridge(made=flying()) as (_, client):
            servers = (await client.call("/rosapi/action_servers"))["values"]["action_servers"]
            assert servers == ["/rov/goto", "/rov/mission", "/uwserver/simulate_steps"]
            kind = (await client.call("/rosapi/action_type", {"action": "/rov/goto"}))["values"]["type"]
            assert kind == "uwserver_msgs/action/Goto"
            told = await client.call("/rosapi/action_goal_details", {"type": kind})
            assert told["values"]["typedefs"][0]["fieldnames"] == ["pose", "speed", "radius"]
            lost = await client.call("/rosapi/action_result_details", {"type": "a/action/B"})
            assert (lost["result"], "no action type" in lost["values"]) == (False, True)

    run(story)


# -- parameters -----------------------------------------------------------------------------------------------------------------------------


def settable():
    made = context()
    rate = Argument("rate_hz", "float", "samples a second", "Hz", required=False)
    made.services = {
        **made.services,
        "rov/imu/get": Service("rov/imu/get", "Of an IMU."),
        "rov/imu/set": Service("rov/imu/set", "Of an IMU.", (rate,)),
    }
    made.scripts["rov/imu/get"] = lambda _: {"rate_hz": 100.0}
    return made


def test_parameters_are_read_and_changed():
    async def story():
        async with bridge(made=settable()) as (world, client):

            async def ask(service, **args):
                return await client.call(f"/rosapi/{service}", args)

            names = (await ask("get_param_names"))["values"]["names"]
            assert names == ["/uwserver:rov.imu.rate_hz"]
            for name in (*names, "rov.imu.rate_hz", "/rov/imu/rate_hz"):
                assert (await ask("get_param", name=name))["values"]["value"] == "100.0"
                assert (await ask("has_param", name=name))["values"]["exists"] is True
            told = (await ask("set_param", name=names[0], value="50"))["values"]
            assert told == {"successful": True, "reason": ""}
            assert [call.args for call in world.calls if call.service == "rov/imu/set"] == [{"rate_hz": 50.0}]
            told = (await ask("set_param", name=names[0], value='"fast"'))["values"]
            assert told == {"successful": False, "reason": "rov.imu.rate_hz must be a number"}
            lost = await ask("set_param", name=names[0], value="fast")
            assert (lost["result"], "must be JSON" in lost["values"]) == (False, True)
            assert (await ask("get_param", name="rov.imu.rate", default_value="7"))["values"]["value"] == "7"
            assert (await ask("delete_param", name=names[0]))["values"]["successful"] is False

    run(story)


# -- much at once ---------------------------------------------------------------------------------------------------------------------------


def test_hundreds_of_throttled_subscriptions_outlive_a_reset():
    """Each has a timer of its own: none holds up another client, and none is left when its client goes."""

    async def story():
        async with bridge(2, queue_bytes=1 << 16) as (world, many, one):
            for k in range(300):
                await many.say(
                    op="subscribe",
                    id=k,
                    topic=f"/rov/{'imu' if k % 2 else 'lasers'}",
                    throttle_rate=k + 1,
                    queue_length=k,
                )
            await many.settle()
            await one.say(op="subscribe", topic="/rov/imu")
            await one.settle()
            for k in range(50):
                world.put([later(k * 10**7), later(k * 10**7, PORTS["rov/lasers"])])
            for _ in range(50):
                assert (await one.hear())["topic"] == "/rov/imu"
            world.say(Event("reset", 0, 0, "again"))
            world.put([later(5)])
            assert (await one.hear())["msg"]["header"]["stamp"]["nanosec"] == 5
            for k in range(300):
                await many.say(op="unsubscribe", id=k, topic=f"/rov/{'imu' if k % 2 else 'lasers'}")
            await many.settle()
            assert world.subscriptions == {"rov/imu"}
            await many.socket.close()
            await one.settle()
            assert world.stats.errors == 0

    run(story)
