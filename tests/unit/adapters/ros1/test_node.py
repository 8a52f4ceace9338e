"""The node on real sockets, over a fake server: with a master, a subscriber, a service client and a publisher of the test's own."""

from __future__ import annotations

import asyncio
import struct
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import msgspec
import pytest
from msgspec import structs
from uwserver_adapters.ros.messages.types import Types
from uwserver_adapters.ros1 import node, wire
from uwserver_adapters.ros1.adapter import Ros1Adapter
from uwserver_adapters.ros1.config import Ros1Config
from uwserver_adapters.ros1.node import ask, place_of

from uwserver.adapter import CannotListen, may_connect
from uwserver.ports import BodyView, EntityList, Refused, Reply, SceneState, SceneView, SensorView
from uwserver.testing import FakeContext

pytest.importorskip("rosbags", reason="rosbags is not installed")
TYPES = Types("noetic")


class Master:
    """What of a ROS master a node needs; `uri` is where."""

    def __init__(self, port: int = 0) -> None:
        self.server = SimpleXMLRPCServer(("127.0.0.1", port), logRequests=False)
        self.port = self.server.server_address[1]
        self.uri = f"http://127.0.0.1:{self.port}/"
        self.nodes: dict[str, str] = {}
        self.publishers: dict[str, list[str]] = {}
        self.registered: set[tuple[str, str, str]] = set()
        self.params: dict[str, Any] = {}
        for name in ("lookupNode", "setParam", "registerPublisher", "registerSubscriber", "registerService",
                     "unregisterPublisher", "unregisterSubscriber", "unregisterService"):  # fmt: skip
            self.server.register_function(getattr(self, name), name)
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def lookupNode(self, caller: str, node: str) -> list[Any]:
        return [1, "", self.nodes[node]] if node in self.nodes else [-1, "unknown node", ""]

    def setParam(self, caller: str, key: str, value: Any) -> list[Any]:
        self.params[key] = value
        return [1, "", 0]

    def registerPublisher(self, caller: str, topic: str, type_name: str, uri: str) -> list[Any]:
        self.nodes[caller] = uri
        self.registered.add(("topic", topic, type_name))
        return [1, "", []]

    def registerSubscriber(self, caller: str, topic: str, type_name: str, uri: str) -> list[Any]:
        self.nodes[caller] = uri
        self.registered.add(("command topic", topic, type_name))
        return [1, "", self.publishers.get(topic, [])]

    def registerService(self, caller: str, service: str, service_uri: str, uri: str) -> list[Any]:
        self.registered.add(("service", service, service_uri))
        return [1, "", 0]

    def _forget(self, caller: str, name: str, uri: str) -> list[Any]:
        self.registered = {each for each in self.registered if each[1] != name}
        return [1, "", 1]

    unregisterPublisher = unregisterSubscriber = unregisterService = _forget

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()


@contextmanager
def a_master(port: int = 0) -> Iterator[Master]:
    master = Master(port)
    try:
        yield master
    finally:
        master.close()


@asynccontextmanager
async def serving(config: Ros1Config, context: FakeContext) -> AsyncIterator[FakeContext]:
    ready = asyncio.Event()
    task = asyncio.ensure_future(Ros1Adapter(config, context).run(ready))
    waiting = asyncio.ensure_future(ready.wait())
    try:
        await asyncio.wait([task, waiting], timeout=60, return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if task.done():
            task.result()
        yield context
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def run(story: Callable[[], Awaitable[None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(story(), 120)

    asyncio.run(bounded())


async def until(condition: Callable[[], object]) -> None:
    for _ in range(6000):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it did not come true")


async def connect(
    context: FakeContext, fields: dict[str, str]
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, dict[str, str]]:
    """A TCPROS connection, and the header that it was answered."""
    host, _, port = str(context.stats.details["tcpros"]).rpartition(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    writer.write(wire.header(fields))
    return reader, writer, wire.fields_of(await block(reader))


async def block(reader: asyncio.StreamReader) -> bytes:
    (length,) = struct.unpack("<I", await reader.readexactly(4))
    return await reader.readexactly(length)


def test_it_registers_and_comes_back_after_the_master(monkeypatch: pytest.MonkeyPatch) -> None:
    async def story() -> None:
        with a_master() as master:
            context = FakeContext()
            async with serving(Ros1Config(master=master.uri), context):
                await until(lambda: ("service", "/world/pause") in {each[:2] for each in master.registered})
                assert ("topic", "/rov/imu", "sensor_msgs/Imu") in master.registered
                assert ("topic", "/clock", "rosgraph_msgs/Clock") in master.registered
                await until(
                    lambda: ("command topic", "/rov/thrusters/cmd", "std_msgs/Float64MultiArray") in master.registered
                )
                assert master.params == {"/use_sim_time": True}
                port = master.port
                await asyncio.to_thread(master.close)
                await until(lambda: "no ROS master" in context.stats.last_error)
                again = Master(port)
                try:
                    await until(lambda: ("service", "/world/pause") in {each[:2] for each in again.registered})
                    await until(lambda: again.nodes.get("/uwserver"))
                finally:
                    await asyncio.to_thread(again.close)

    # The first master is closed within the story.
    monkeypatch.setattr(Master, "close", _closed_once(Master.close))
    monkeypatch.setattr(node, "RETRY_S", 0.05)
    monkeypatch.setattr(node, "CHECK_S", 0.05)
    run(story)


def _closed_once(close: Callable[[Master], None]) -> Callable[[Master], None]:
    done: set[int] = set()

    def once(master: Master) -> None:
        if id(master) not in done:
            done.add(id(master))
            close(master)

    return once


def test_a_subscriber_hears_what_it_asked_for_alone() -> None:
    async def story() -> None:
        context = FakeContext()
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            md5 = "6a62c6daae103f4ff57a132d6f95cec2"
            reader, writer, said = await connect(
                context, {"callerid": "/rviz", "topic": "/rov/imu", "type": "sensor_msgs/Imu", "md5sum": md5}
            )
            assert (said["type"], said["md5sum"], said["latching"]) == ("sensor_msgs/Imu", md5, "0")
            assert "linear_acceleration" in said["message_definition"]
            assert context.subscriptions == {"rov/imu"}
            context.emit()
            imu = TYPES.from_ros1(await block(reader), "sensor_msgs/msg/Imu")
            assert imu.header.frame_id.startswith("rov/")
            busy = await ask(context.stats.address, "getBusInfo", "/t")
            assert [each[1:5] for each in busy] == [["/rviz", "o", "TCPROS", "/rov/imu"]]
            writer.close()
            await until(lambda: context.emit() or context.subscriptions == frozenset())

    run(story)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"topic": "/rov/imy"}, 'did you mean "/rov/imu"'),
        ({"topic": "/rov/imu", "type": "sensor_msgs/Range", "md5sum": "*"}, "sensor_msgs/Imu"),
        ({"topic": "/rov/imu", "md5sum": "0"}, "md5sum 6a62c6daae103f4ff57a132d6f95cec2"),
        ({"service": "/world/pose"}, 'did you mean "/world/pause"'),
        ({}, "a topic or a service"),
    ],
)
def test_what_does_not_match_is_told(fields: dict[str, str], text: str) -> None:
    async def story() -> None:
        context = FakeContext()
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            reader, writer, said = await connect(context, {"callerid": "/x", **fields})
            assert text in said["error"]
            assert await reader.read() == b""
            writer.close()

    run(story)


def test_services_once_and_persistent() -> None:
    async def story() -> None:
        context = FakeContext()
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            fields = {"callerid": "/x", "service": "/world/pause", "md5sum": "937c9679a518e3a18d831e57125ea522"}
            reader, writer, said = await connect(context, fields)
            assert said["type"] == "std_srvs/Trigger"
            writer.write(wire.block(b""))
            answer = await reader.read()
            assert answer[:1] == b"\x01"
            assert TYPES.from_ros1(answer[5:], "std_srvs/srv/Trigger_Response").success
            writer.close()
            reader, writer, _ = await connect(context, {**fields, "md5sum": "*", "persistent": "1"})
            writer.write(wire.block(b"") * 3 + wire.block(b"too long"))
            for _ in range(3):
                assert await reader.readexactly(1) == b"\x01"
                await block(reader)
            assert await reader.readexactly(1) == b"\x00"
            assert b"not of this type" in await block(reader)
            writer.close()
            _, writer, said = await connect(context, {**fields, "probe": "1"})
            assert said["request_type"] == "std_srvs/TriggerRequest"
            writer.close()

    run(story)


RUN_UNTIL = {"callerid": "/x", "service": "/world/run_until", "md5sum": "*", "persistent": "1"}


def test_calls_of_a_client_are_carried_out_one_after_the_other() -> None:
    async def story() -> None:
        context = FakeContext(held={"world/run_until"})
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            reader, writer, _ = await connect(context, RUN_UNTIL)
            writer.write(wire.block(struct.pack("<d", 1.0)) + wire.block(struct.pack("<d", 2.0)))
            for n in (1, 2):
                await until(lambda n=n: len(context.calls) == n)  # type: ignore[misc]
                await asyncio.sleep(0.02)
                assert [call.args["t_s"] for call in context.calls] == [1.0, 2.0][:n]
                context.calls[-1].finish(Reply(n, n))
                assert await reader.readexactly(1) == b"\x01"
                await block(reader)
            writer.close()

    run(story)


def test_a_client_that_leaves_has_its_long_calls_ended() -> None:
    async def story() -> None:
        context = FakeContext(held={"world/run_until"})
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            _, writer, _ = await connect(context, RUN_UNTIL)
            writer.write(wire.block(struct.pack("<d", 1.0)) + wire.block(struct.pack("<d", 2.0)))
            await until(lambda: context.calls)
            writer.close()
            await until(lambda: all(call.is_done for call in context.calls) and context.stats.peers == 0)

    run(story)


def test_what_a_client_asks_before_its_answer_is_kept_up_to_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire, "MESSAGE_LIMIT", 1000)

    async def story() -> None:
        context = FakeContext(held={"world/run_until"})
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            reader, writer, _ = await connect(context, RUN_UNTIL)
            writer.write(wire.block(struct.pack("<d", 1.0)))
            await until(lambda: context.calls)
            writer.write(wire.block(struct.pack("<d", 2.0)) * 100)
            assert await reader.readexactly(1) == b"\x00"
            assert b"before they were answered" in await block(reader)
            writer.close()
            await until(lambda: context.calls[0].is_done)
            assert len(context.calls) == 1

    run(story)


def test_nothing_is_kept_of_what_a_subscriber_says(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[wire.Blocks] = []

    class Watched(wire.Blocks):
        def __init__(self) -> None:
            super().__init__()
            made.append(self)

    monkeypatch.setattr(wire, "Blocks", Watched)

    async def story() -> None:
        context = FakeContext()
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            reader, writer, _ = await connect(context, {"callerid": "/x", "topic": "/rov/imu", "md5sum": "*"})
            writer.write(b"x" * 1_000_000)
            await writer.drain()
            writer.write_eof()
            assert await reader.read() == b""
            assert [blocks.waiting for blocks in made] == [0]
            writer.close()

    run(story)


class Unstarted(FakeContext):
    """A world before its first tick: it knows where its sensors sit, but answers no request for the scene."""

    def scene(self, entities: EntityList) -> SceneView:
        sensor = SensorView("rov/imu", "imu", (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0), message="Imu")
        return structs.replace(super().scene(entities), vehicles=(BodyView("rov", "x", "rov", (), sensors=(sensor,)),))

    def request_scene_state(self, on_state: Callable[[SceneState], None], source: str = "") -> None:
        pass


def test_late_subscribers_hear_where_sensors_sit_though_no_tick_came_yet() -> None:
    async def story() -> None:
        context = Unstarted()
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            reader, writer, said = await connect(context, {"callerid": "/x", "topic": "/tf_static", "md5sum": "*"})
            assert said["latching"] == "1"
            told = TYPES.from_ros1(await block(reader), "tf2_msgs/msg/TFMessage")
            assert "rov/imu" in {each.child_frame_id for each in told.transforms}
            writer.close()

    run(story)


class Publisher:
    """A node that publishes thruster commands, and its API."""

    def __init__(self, host: str = "127.0.0.1") -> None:
        self.server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        self.uri = f"http://127.0.0.1:{self.server.server_address[1]}/"
        self.host, self.port = host, 0
        self.server.register_function(lambda *_: [1, "", ["TCPROS", self.host, self.port]], "requestTopic")
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()
        self.writers: list[asyncio.StreamWriter] = []
        self.heard: list[dict[str, str]] = []

    async def begin(self) -> asyncio.Server:
        server = await asyncio.start_server(self._greet, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        return server

    async def _greet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.heard.append(wire.fields_of(await block(reader)))
        writer.write(wire.header({"callerid": "/pilot", "md5sum": "*", "type": "*"}))
        self.writers.append(writer)


def test_a_publisher_commands_and_its_faults_are_told_on_rosout() -> None:
    async def story() -> None:
        publisher = Publisher()
        server = await publisher.begin()
        with a_master() as master:
            master.publishers["/rov/thrusters/cmd"] = [publisher.uri]
            context = FakeContext()
            async with serving(Ros1Config(master=master.uri), context):
                await until(lambda: publisher.writers)
                assert publisher.heard[0]["type"] == "std_msgs/Float64MultiArray"
                (writer,) = publisher.writers
                reader, hand, _ = await connect(context, {"callerid": "/x", "topic": "/rosout", "md5sum": "*"})
                for data in ([0.5] * 8, [5.0] * 8):
                    made = TYPES.make("std_msgs/msg/Float64MultiArray", data=_array(data))
                    writer.write(wire.block(TYPES.ros1(made)))
                writer.write(wire.block(b"garbage"))
                log = TYPES.from_ros1(await block(reader), "rosgraph_msgs/msg/Log")
                assert log.msg.startswith("/rov/thrusters/cmd: ")
                assert [command.value for command in context.commands] == [((0.5,) * 8,)]
                await until(lambda: context.stats.errors >= 2)
                hand.close()
                writer.close()
        publisher.server.shutdown()
        publisher.server.server_close()
        server.close()

    run(story)


def _array(data: list[float]) -> Any:
    import numpy as np

    return np.array(data)


def test_a_publisher_that_names_another_host_is_not_connected_to() -> None:
    async def story() -> None:
        publisher = Publisher("192.0.2.7")
        with a_master() as master:
            master.publishers["/rov/thrusters/cmd"] = [publisher.uri]
            context = FakeContext()
            async with serving(Ros1Config(master=master.uri), context):
                await until(lambda: "192.0.2.7" in context.stats.last_error)
                assert "allowed_hosts" in context.stats.last_error
        publisher.server.shutdown()
        publisher.server.server_close()

    run(story)


def test_hosts() -> None:
    assert all(may_connect(host, ()) for host in ("localhost", "127.0.0.1", "127.0.1.1", "::1"))
    assert not may_connect("10.0.0.2", ())
    assert may_connect("10.0.0.2", ("10.0.0.2",))
    assert place_of("http://robot:11311") == ("robot", 11311, "/")
    for uri in ("", "robot:11311", "ftp://robot:1/", "http://robot/", "http://robot:99999/", "http://[::1"):
        with pytest.raises(Refused):
            place_of(uri)


def test_the_api_answers_nonsense_by_its_codes() -> None:
    async def story() -> None:
        context = FakeContext()
        async with serving(Ros1Config(master="http://127.0.0.1:9"), context):
            uri = context.stats.address
            assert isinstance(await ask(uri, "getPid", "/x"), int)
            assert ["/rov/imu", "sensor_msgs/Imu"] in await ask(uri, "getPublications", "/x")
            for method, args in (("requestTopic", ("/x", "/no", [["TCPROS"]])), ("requestTopic", ("/x",)), ("nothing", ()),
                                 ("requestTopic", ("/x", "/rov/imu", [["UDPROS"]])), ("shutdown", ("/x", "go"))):  # fmt: skip
                with pytest.raises(Refused):
                    await ask(uri, method, *args)
            assert await ask(uri, "publisherUpdate", "/m", "/rov/imu", [3, {"a": 1}]) == 0

    run(story)


def test_only_this_machine_unless_told() -> None:
    async def story() -> None:
        with pytest.raises(CannotListen, match="allow_network"):
            async with serving(Ros1Config(bind="0.0.0.0"), FakeContext()):
                pass

    run(story)


def test_others_must_be_told_an_address_that_leads_here() -> None:
    async def story() -> None:
        with pytest.raises(CannotListen, match="Say host"):
            async with serving(Ros1Config(bind="0.0.0.0", allow_network=True), FakeContext()):
                pass

    run(story)


@pytest.mark.parametrize("node", ["uwserver", "/", "/a b", "/1", "/a//b", "/a/"])
def test_names_of_nodes_are_those_that_ros_takes(node: str) -> None:
    assert msgspec.convert({"node": "/sea/uwserver_1"}, Ros1Config).node == "/sea/uwserver_1"
    with pytest.raises(msgspec.ValidationError, match="node"):
        msgspec.convert({"node": node}, Ros1Config)
