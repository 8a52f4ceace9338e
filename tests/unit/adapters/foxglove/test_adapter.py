"""A client of Foxglove, spoken by hand, over a world of the test."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import struct
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from uwserver_adapters.foxglove import FoxgloveAdapter
from uwserver_adapters.foxglove.config import FoxgloveConfig
from uwserver_adapters.foxglove.outbox import Outbox
from video_rig import CAMERA
from video_rig import sample as filmed
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Subprotocol

from uwserver.adapter import VehicleFacts
from uwserver.adapter.foxglove import channels
from uwserver.ports import (
    Argument,
    EntityList,
    Event,
    Field,
    Port,
    Present,
    Reply,
    SceneState,
    SceneView,
    SensorView,
    Service,
)
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import PORTS, SERVICES

ROV = EntityList(3, (Present("rov", "rov"),), ())
GPS = Port(
    "rov/gps", "sensor", "gps",
    tuple(Field(n, "1", "") for n in ("latitude", "longitude", "height", "horizontal_accuracy", "vertical_accuracy")), "", message="NavSatFix",
)  # fmt: skip
SETTINGS = (
    Service("rov/gps/get", "Get."),
    Service(
        "rov/gps/set",
        "Set.",
        (Argument("rate_hz", "float", "x", required=False), Argument("satellites", "int", "x", required=False)),
    ),
)
PLAYBACK = tuple(
    Service(f"playback/{name}", "x", arguments, reads_only=name == "state")
    for name, arguments in (
        ("pause", ()), ("resume", ()), ("seek", (Argument("t_s", "float", "x"),)), ("speed", (Argument("speed", "float", "x"),)), ("state", ()),
    )
)  # fmt: skip
SENSOR = next(port for port in PORTS if port.direction == "sensor" and not any(f.is_packed for f in port.fields))
ACTUATOR = next(port for port in PORTS if port.direction == "actuator")


class Peer:
    """A client: what it heard, by kind."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.texts: list[dict[str, Any]] = []
        self.binaries: list[bytes] = []

    async def say(self, **message: Any) -> None:
        await self.connection.send(json.dumps(message))

    async def until(self, found: Callable[[], Any]) -> Any:
        """Hear until something is there."""
        while not (it := found()):
            message = await asyncio.wait_for(self.connection.recv(), 60.0)
            if isinstance(message, str):
                self.texts.append(json.loads(message))
            else:
                self.binaries.append(message)
        return it

    async def text(self, op: str) -> dict[str, Any]:
        """The next one of a kind."""
        found: dict[str, Any] = await self.until(lambda: [m for m in self.texts if m["op"] == op])
        self.texts.remove(found[0])
        return found[0]  # type: ignore[no-any-return]

    async def data(self, subscription: int) -> tuple[int, bytes]:
        """Time and payload of the next message of a subscription."""
        head = struct.pack("<BI", 1, subscription)
        (first, *_) = await self.until(lambda: [m for m in self.binaries if m.startswith(head)])
        self.binaries.remove(first)
        return struct.unpack_from("<Q", first, 5)[0], first[13:]

    async def binary(self, kind: int) -> bytes:
        (first, *_) = await self.until(lambda: [m for m in self.binaries if m[0] == kind])
        self.binaries.remove(first)
        return first  # type: ignore[no-any-return]

    async def offered(self) -> dict[str, int]:
        """Numbers of channels by topic."""
        return {channel["topic"]: channel["id"] for channel in (await self.text("advertise"))["channels"]}


def context(**more: Any) -> FakeContext:
    ports = {port.path: port for port in (*PORTS, GPS)}
    services = {service.path: service for service in (*SERVICES, *SETTINGS, *more.pop("services", ()))}
    found = FakeContext(ports=ports, services=services, **more)
    found.world = type(found.world)(
        **{
            **{n: getattr(found.world, n) for n in found.world.__struct_fields__},
            "vehicles": (VehicleFacts("rov", "x"),),
        }
    )
    poses = np.array([[1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]])
    found.scene_state = SceneState(ROV, 5_000_000_000, poses, np.zeros(0, np.int8), (0.0, 0.0, 0.0))
    return found


@contextlib.asynccontextmanager
async def running(world: FakeContext, **table: Any) -> AsyncIterator[FoxgloveAdapter]:
    adapter = FoxgloveAdapter(FoxgloveConfig(**{"port": 0, **table}), world)
    ready = asyncio.Event()
    task = asyncio.create_task(adapter.run(ready))
    await asyncio.wait_for(ready.wait(), 60.0)
    try:
        yield adapter
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def dial(world: FakeContext, path: str = "/", protocol: str = "foxglove.sdk.v1", **options: Any) -> connect:
    # An adapter that no longer reads, as some tests make it, does not answer the end of the connection either.
    return connect(f"{world.stats.address}{path}", subprotocols=[Subprotocol(protocol)], close_timeout=0.2, **options)


def run(
    test: Callable[[FakeContext, Peer], Awaitable[None]], world: FakeContext | None = None, **table: Any
) -> FakeContext:
    """A test with one client."""
    found: list[FakeContext] = []

    async def whole() -> None:
        here = world or context()
        found.append(here)
        async with running(here, **table), dial(here) as connection:
            await test(here, Peer(connection))

    asyncio.run(asyncio.wait_for(whole(), 120.0))
    return found[0]


def test_a_greeting_names_all_that_is_offered() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        info = await peer.text("serverInfo")
        assert info["capabilities"] == ["clientPublish", "parameters", "services", "time"]
        offered = await peer.offered()
        assert {SENSOR.path, "rov/gps", "/rov/gps", "/tf", "/scene", "/log", "/rov/pose"} <= set(offered)
        assert ACTUATOR.path not in offered
        services = await peer.text("advertiseServices")
        assert {service["name"] for service in services["services"]} == set(world.services)

    run(test)


def test_samples_of_what_is_subscribed_and_nothing_else() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        offered = await peer.offered()
        assert world.subscriptions == frozenset()
        await peer.say(op="subscribe", subscriptions=[{"id": 5, "channelId": offered[SENSOR.path]}])
        await _settled(lambda: world.subscriptions == {SENSOR.path})
        world.emit()
        t_ns, payload = await peer.data(5)
        told = json.loads(payload)
        assert t_ns == told["t_sent_ns"]
        assert set(told["value"]) == {field.name for field in SENSOR.fields}
        await peer.say(op="unsubscribe", subscriptionIds=[5])
        await _settled(lambda: not world.subscriptions)

    run(test)


async def _settled(condition: Callable[[], bool]) -> None:
    for _ in range(12000):
        if condition():
            return
        await asyncio.sleep(0.005)
    raise AssertionError("it did not come to that")


def test_poses_frames_shapes_and_time() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        offered = await peer.offered()
        topics = {n: offered[topic] for n, topic in enumerate(("/tf", "/rov/pose", "/scene"))}
        await peer.say(op="subscribe", subscriptions=[{"id": n, "channelId": channel} for n, channel in topics.items()])
        world.scene_state = world.scene_state._replace(t_ns=6_000_000_000)
        t_ns, tf = await peer.data(0)
        assert t_ns == 6_000_000_000
        assert b"N_enu" in tf
        assert (await peer.data(1))[0] == t_ns
        assert b"rov" in (await peer.data(2))[1]
        assert int.from_bytes((await peer.binary(2))[1:], "little") in (5_000_000_000, 6_000_000_000)

    run(test)


def test_poses_are_no_secret_only_where_the_table_says_so() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        offered = await peer.offered()
        assert not {"/tf", "/scene", "/rov/pose"} & set(offered)
        assert "/log" in offered

    run(test, exact_poses=False)


def test_calls_and_their_failures() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        services = {s["name"]: s["id"] for s in (await peer.text("advertiseServices"))["services"]}

        async def call(service: int, body: bytes, encoding: bytes = b"json") -> None:
            await peer.connection.send(struct.pack("<BIII", 2, service, 44, len(encoding)) + encoding + body)

        await call(services["world/echo"], b'{"value": 3.5}')
        answer = await peer.binary(3)
        assert struct.unpack_from("<III", answer, 1) == (services["world/echo"], 44, 4)
        assert json.loads(answer[17:]) == 3.5
        for service, body, encoding in (
            (services["world/echo"], b'{"valeu": 3.5}', b"json"), (services["world/echo"], b"[1]", b"json"),
            (services["world/echo"], b"{}", b"ros1"), (999, b"{}", b"json"),
        ):  # fmt: skip
            await call(service, body, encoding)
            failure = await peer.text("serviceCallFailure")
            assert (failure["serviceId"], failure["callId"]) == (service, 44)
            assert failure["message"]

    run(test)


def test_commands_of_published_channels() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        name, size = ACTUATOR.fields[0].name, ACTUATOR.fields[0].size
        value = [0.0] * size if ACTUATOR.fields[0].shape else 0.0
        await peer.say(
            op="advertise", channels=[{"id": 1, "topic": f"/{ACTUATOR.path}", "encoding": "json", "schemaName": ""}]
        )
        await peer.connection.send(struct.pack("<BI", 1, 1) + json.dumps({name: value}).encode())
        await _settled(lambda: len(world.commands) == 1)
        assert world.commands[0].port == ACTUATOR.path
        await peer.connection.send(struct.pack("<BI", 1, 1) + b'{"nonsense": 1}')
        assert "nonsense" in (await peer.text("status"))["message"]
        await peer.connection.send(struct.pack("<BI", 1, 77) + b"{}")
        assert "not advertised" in (await peer.text("status"))["message"]
        await peer.say(op="advertise", channels=[{"id": 2, "topic": ACTUATOR.path + "s", "encoding": "json"}])
        assert ACTUATOR.path in (await peer.text("status"))["message"]
        assert len(world.commands) == 1

    run(test)


def test_parameters_are_settings() -> None:
    settings = {"rate_hz": 5.0, "satellites": 12, "active": True}

    async def test(world: FakeContext, peer: Peer) -> None:
        world.scripts["rov/gps/get"] = lambda args: dict(settings)
        world.scripts["rov/gps/set"] = settings.update
        await peer.say(op="getParameters", parameterNames=[], id="a")
        told = await peer.text("parameterValues")
        assert told["id"] == "a"
        assert told["parameters"] == [
            {"name": "rov/gps/rate_hz", "value": 5.0},
            {"name": "rov/gps/satellites", "value": 12},
        ]
        await peer.say(
            op="setParameters",
            parameters=[{"name": "rov/gps/satellites", "value": 3}, {"name": "rov/gps/satelites", "value": 1}],
            id="b",
        )
        told = await peer.text("parameterValues")
        assert told["parameters"] == [{"name": "rov/gps/satellites", "value": 3}]
        assert 'did you mean "rov/gps/satellites"' in (await peer.text("status"))["message"]

    run(test)


def test_events_are_log_lines_and_a_reset_begins_a_session() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        first = await peer.text("serverInfo")
        offered = await peer.offered()
        await peer.say(op="subscribe", subscriptions=[{"id": 1, "channelId": offered["/log"]}])
        await peer.say(op="getParameters", parameterNames=["none"])
        await peer.text("parameterValues")
        world.say(Event("reset", 0, 0, "back to the start"))
        assert b"back to the start" in (await peer.data(1))[1]
        second = await peer.text("serverInfo")
        assert second["sessionId"] != first["sessionId"]
        assert await peer.offered() == offered

    run(test)


class Filmed(FakeContext):
    """A world whose rov has a camera."""

    def scene(self, entities: EntityList) -> SceneView:
        seen = super().scene(entities)
        eye = SensorView(CAMERA.path, "camera", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), message="Image")
        return replace(seen, vehicles=tuple(replace(body, sensors=(eye,)) for body in seen.vehicles))


def test_pictures_are_made_on_a_thread_and_none_is_shown_after_a_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, gate, threads = threading.Event(), threading.Event(), set[bool]()

    def slow(shown: object, quality: int = 80) -> bytes:
        threads.add(threading.current_thread() is threading.main_thread())
        begun.set()
        assert gate.wait(60.0)
        return b"a picture"

    monkeypatch.setattr(channels, "jpeg", slow)

    async def test(world: FakeContext, peer: Peer) -> None:
        offered = await peer.offered()
        topics = (f"/{CAMERA.path}", "/scene")
        await peer.say(
            op="subscribe", subscriptions=[{"id": k, "channelId": offered[topic]} for k, topic in enumerate(topics)]
        )
        await _settled(lambda: world.subscriptions == {CAMERA.path})
        await peer.data(1)  # the world has been looked at
        world.put([filmed(1), filmed(2)])
        assert await asyncio.to_thread(begun.wait, 10.0), "the loop goes on meanwhile"
        world.say(Event("reset", 0, 0, "back"))
        world.put([filmed(3), filmed(4)])
        gate.set()
        told = [await peer.data(0) for _ in range(2)]
        assert [t_ns for t_ns, _ in told] == [filmed(3).t_sent_ns, filmed(4).t_sent_ns]
        assert all(b"a picture" in payload for _, payload in told)

    known = context()
    world = Filmed(**{name: getattr(known, name) for name in ("services", "world", "scene_state")})
    world.set_ports((*PORTS, CAMERA))
    run(test, world)
    assert threads == {False}


def test_ports_that_come_and_go() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        offered = await peer.offered()
        world.ports = {path: port for path, port in world.ports.items() if path != "rov/gps"}
        world.say(Event("ports_changed", 1, 2, "it left"))
        gone = await peer.text("unadvertise")
        assert set(gone["channelIds"]) == {offered["rov/gps"], offered["/rov/gps"]}
        world.ports = {**world.ports, "rov/gps": GPS}
        world.say(Event("ports_changed", 1, 3, "it came back"))
        assert await peer.offered() == {topic: offered[topic] for topic in ("rov/gps", "/rov/gps")}

    run(test)


def test_playback_is_steered() -> None:
    state = {"t_s": 4.0, "from_s": 0.0, "to_s": 9.0, "speed": 1.0, "paused": True}

    async def test(world: FakeContext, peer: Peer) -> None:
        info = await peer.text("serverInfo")
        assert "playbackControl" in info["capabilities"]
        assert info["dataEndTime"] == {"sec": 9, "nsec": 0}
        await peer.binary(5)  # how it stands, to begin with
        await peer.connection.send(struct.pack("<BBfBQI", 3, 0, 2.0, 1, 3_500_000_000, 2) + b"id")
        answer = await peer.binary(5)
        asked = {call.service: call.args for call in world.calls}
        assert asked["playback/seek"] == {"t_s": 3.5}
        assert asked["playback/speed"] == {"speed": 2.0}
        assert "playback/resume" in asked
        assert answer.endswith(b"id")
        assert struct.unpack_from("<BQf", answer, 1) == (1, 4_000_000_000, 1.0)

    world = context(services=PLAYBACK)
    world.scripts |= {f"playback/{name}": lambda args: None for name in ("pause", "resume", "seek", "speed")}
    world.scripts["playback/state"] = lambda args: dict(state)
    run(test, world)


def test_a_player_that_answers_later_has_its_play_bar_too() -> None:
    state = {"t_s": -4.0, "from_s": -5.0, "to_s": 9.0, "speed": 1.0, "paused": False}

    async def whole() -> None:
        world = context(services=PLAYBACK)
        world.held = {"playback/state"}

        async def answer() -> None:
            await _settled(lambda: bool(world.calls))
            world.calls.pop().finish(Reply(0, 0, dict(state)))

        async with running(world), dial(world) as connection:
            peer = Peer(connection)
            await answer()
            info = await peer.text("serverInfo")
            assert "playbackControl" in info["capabilities"]
            assert (info["dataStartTime"]["sec"], info["dataEndTime"]["sec"]) == (0, 9)
            await answer()
            assert struct.unpack_from("<BQf", await peer.binary(5), 1) == (0, 0, 1.0)
            state["to_s"] = 7.0
            world.say(Event("reset", 0, 0, "another run"))
            await peer.text("serverInfo")
            await answer()
            assert (await peer.text("serverInfo"))["dataEndTime"]["sec"] == 7
            assert (await peer.binary(5))[14] == 1

    asyncio.run(asyncio.wait_for(whole(), 120.0))


def test_a_world_that_lives_cannot_be_sought_in() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        await peer.connection.send(struct.pack("<BBfBQI", 3, 0, 2.0, 1, 3_500_000_000, 2) + b"id")
        assert "only in a recording" in (await peer.text("status"))["message"]

    run(test)


@pytest.mark.parametrize(
    "message",
    [
        "nonsense", "[]", '{"op":"fly"}', '{"op":"subscribe"}', '{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}',
        '{"op":"subscribe","subscriptions":[{"id":1,"channelId":999}]}', '{"op":"unsubscribe","subscriptionIds":[3]}',
        '{"op":"setParameters","parameters":7}', b"\x09", b"\x01\x01", b"",
    ],
)  # fmt: skip
def test_nonsense_is_told_and_the_connection_stays(message: str | bytes) -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        await peer.connection.send(message)
        status = await peer.text("status")
        assert status["level"] == 2
        await peer.say(op="getParameters", parameterNames=["none"], id="still")
        assert (await peer.text("parameterValues"))["id"] == "still"

    run(test)


def test_who_may_only_watch_changes_nothing() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        services = {s["name"]: s["id"] for s in (await peer.text("advertiseServices"))["services"]}
        await peer.connection.send(struct.pack("<BIII", 2, services["rov/gps/set"], 1, 4) + b"json{}")
        assert "read_only" in (await peer.text("serviceCallFailure"))["message"]
        await peer.say(op="advertise", channels=[{"id": 1, "topic": ACTUATOR.path, "encoding": "json"}])
        assert "read_only" in (await peer.text("status"))["message"]
        await peer.say(op="setParameters", parameters=[{"name": "rov/gps/rate_hz", "value": 1}])
        assert "read_only" in (await peer.text("status"))["message"]
        assert not world.commands
        assert not world.calls

    run(test, read_only=True)


@pytest.mark.parametrize(
    ("table", "options", "path", "status"),
    [
        ({}, {"origin": "https://evil.example"}, "/", 403),
        ({}, {"additional_headers": {"Host": "evil.example"}}, "/", 403),
        ({"token": "sesame"}, {}, "/", 401),
        ({"token": "sesame"}, {}, "/sesam", 401),
        ({"max_clients": 1}, {}, "second", 503),
    ],
)
def test_who_is_not_let_in(table: dict[str, Any], options: dict[str, Any], path: str, status: int) -> None:
    async def whole() -> None:
        world = context()
        async with running(world, **table):
            async with contextlib.AsyncExitStack() as stack:
                if path == "second":
                    await stack.enter_async_context(dial(world))
                with pytest.raises(InvalidStatus) as refused:
                    await dial(world, "/" if path == "second" else path, **options)
                assert refused.value.response.status_code == status
        assert sum(world.stats.details["refused"].values()) == 1  # type: ignore[union-attr, arg-type, misc]

    asyncio.run(asyncio.wait_for(whole(), 120.0))


@pytest.mark.parametrize(
    ("table", "options", "path", "protocol"),
    [
        ({}, {"origin": "https://app.foxglove.dev"}, "/", "foxglove.sdk.v1"), ({}, {"origin": "http://localhost:8080"}, "/", "foxglove.sdk.v1"),
        ({"token": "sesame"}, {}, "/sesame", "foxglove.sdk.v1"), ({}, {}, "/", "foxglove.websocket.v1"),
    ],
)  # fmt: skip
def test_who_is_let_in(table: dict[str, Any], options: dict[str, Any], path: str, protocol: str) -> None:
    async def whole() -> None:
        world = context()
        async with running(world, **table), dial(world, path, protocol, **options) as connection:
            assert connection.subprotocol == protocol
            assert json.loads(await connection.recv())["op"] == "serverInfo"

    asyncio.run(asyncio.wait_for(whole(), 120.0))


@pytest.mark.parametrize(
    ("origin", "table", "may"),
    [
        ("https://app.foxglove.dev", {}, False), ("file://", {}, False), ("http://localhost:8080", {}, False), (None, {}, True),
        ("file://", {"allowed_origins": ("file://",)}, True), ("http://localhost:81", {"allowed_origins": ("http://localhost:*",)}, True),
    ],
)  # fmt: skip
def test_pages_that_the_table_does_not_name_only_watch(origin: str | None, table: dict[str, Any], may: bool) -> None:
    async def whole() -> None:
        world = context()
        async with running(world, **table), dial(world, origin=origin) as connection:
            peer = Peer(connection)
            services = {s["name"]: s["id"] for s in (await peer.text("advertiseServices"))["services"]}
            await peer.connection.send(struct.pack("<BIII", 2, services["rov/gps/set"], 1, 4) + b"json{}")
            await peer.say(op="advertise", channels=[{"id": 1, "topic": ACTUATOR.path, "encoding": "json"}])
            await peer.say(op="setParameters", parameters=[{"name": "rov/gps/rate_hz", "value": 1}])
            await peer.say(op="getParameters", parameterNames=["none"], id="watch")
            await peer.until(lambda: [m for m in peer.texts if m.get("id") == "watch"])
            refused = [m["message"] for m in peer.texts if "may only watch" in m.get("message", "")]
            assert len(refused) == (0 if may else 3)
            assert bool([c for c in world.calls if c.service == "rov/gps/set"]) is may

    asyncio.run(asyncio.wait_for(whole(), 120.0))


def test_who_tries_tokens_is_not_heard_for_a_while() -> None:
    async def whole() -> None:
        world = context()
        async with running(world, token="sesame"):
            found = []
            for path in ["/wrong"] * 12 + ["/sesame"]:
                with pytest.raises(InvalidStatus) as refused:
                    await dial(world, path)
                found.append(refused.value.response.status_code)
            assert found[:3] == [401] * 3
            assert found[-1] == 429  # with the right one, too

    asyncio.run(asyncio.wait_for(whole(), 120.0))


def test_another_protocol_is_refused() -> None:
    async def whole() -> None:
        world = context()
        async with running(world):
            with pytest.raises(InvalidStatus):
                await dial(world, protocol="mqtt")

    asyncio.run(asyncio.wait_for(whole(), 120.0))


def test_who_floods_is_told_once_and_not_heard(caplog: pytest.LogCaptureFixture) -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        for _ in range(50):
            await peer.connection.send("{}")
        await peer.until(lambda: [m for m in peer.texts if "max_requests_per_s" in m.get("message", "")])
        assert len([m for m in peer.texts if m["op"] == "status"]) <= 7

    run(test, max_requests_per_s=5)


def test_a_client_that_floods_waits_and_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uwserver.adapter.peers.WINDOW_S", 0.05)

    async def test(world: FakeContext, peer: Peer) -> None:
        for n in range(30):
            await peer.say(op="getParameters", parameterNames=["none"], id=str(n))
        await peer.until(lambda: [m for m in peer.texts if m.get("id") == "29"])
        assert [m["id"] for m in peer.texts if m["op"] == "parameterValues"] == [str(n) for n in range(30)]

    refused: Any = run(test, max_requests_per_s=5).stats.details["refused"]
    assert refused["flood"] >= 3


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        ({"op": "unsubscribe", "subscriptionIds": [7] * 900}, "no subscription 7 (and 899 more of this message)"),
        ({"op": "unsubscribe", "subscriptionIds": [7] * 6000}, "6000 entries: at most 1024"),
        ({"op": "subscribe", "subscriptions": [{"id": n, "channelId": 9999} for n in range(900)]}, "(and 899 more"),
        ({"op": "subscribe", "subscriptions": [{"id": n, "channelId": 1} for n in range(108)]}, "(and 99 more"),
        ({"op": "setParameters", "parameters": [{"name": f"rov/gps/{n}", "value": 1} for n in range(600)]}, "(and 599"),
        ({"op": "subscribeParameterUpdates", "parameterNames": ["x"] * 1025}, "1025 entries"),
    ],
)
def test_a_message_is_answered_with_one_complaint_however_long_it_is(message: dict[str, Any], complaint: str) -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        await peer.say(**message)
        await peer.say(op="getParameters", parameterNames=["none"], id="after")
        await peer.until(lambda: [m for m in peer.texts if m.get("id") == "after"])
        (told,) = [m["message"] for m in peer.texts if m["op"] == "status"]
        assert complaint in told

    run(test)


def test_names_of_parameters_are_compared_with_the_known_ones_once_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[str] = []

    def suggest(name: str, known: object) -> str:
        compared.append(name)
        return ""

    monkeypatch.setattr("uwserver_adapters.foxglove.client.did_you_mean", suggest)

    async def test(world: FakeContext, peer: Peer) -> None:
        await peer.say(op="setParameters", parameters=[{"name": f"no/{n}", "value": 1} for n in range(600)])
        await peer.text("parameterValues")
        assert compared == ["no/0"]

    run(test)


def test_an_outbox_that_overflows_says_so_once_and_drops_all() -> None:
    async def whole() -> None:
        world, overflows = context(), []
        outbox = Outbox(_never, 10, 1 << 20, world.stats, lambda: overflows.append(1))
        for _ in range(100):
            outbox.put(b"x")
        assert overflows == [1]
        assert not outbox._waiting
        assert world.stats.dropped == 100

    asyncio.run(whole())


def test_json_that_is_costly_to_decode_is_refused_unread() -> None:
    async def test(world: FakeContext, peer: Peer) -> None:
        await peer.connection.send('{"op":"getParameters","parameterNames":[],"id":[' + ",".join(["[]"] * 9000) + "]}")
        assert "values in one message" in (await peer.text("status"))["message"]
        assert not [m for m in peer.texts if m["op"] == "parameterValues"]

    run(test)


def test_a_client_that_does_not_read_loses_samples_and_nobody_waits() -> None:
    async def whole() -> None:
        world = context()
        async with running(world, queue_messages=50) as adapter, dial(world, max_queue=1) as connection:
            await connection.send(
                json.dumps({"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in range(1, 6)]})
            )
            await _settled(lambda: bool(world.subscriptions))
            (client,) = adapter.clients
            client.outbox._send = _never  # type: ignore[assignment]
            for _ in range(500):
                world.emit()
            assert world.stats.dropped > 100
            assert len(client.outbox._waiting) <= 50
            for _ in range(60):
                client.complain("x")
            await _settled(lambda: not adapter.clients)

    asyncio.run(asyncio.wait_for(whole(), 120.0))


async def _never(_: str | bytes) -> None:
    await asyncio.get_running_loop().create_future()


def test_beyond_loopback_a_token_is_made(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)

    async def whole() -> None:
        world = context()
        async with running(world, bind="0.0.0.0"):
            with pytest.raises(InvalidStatus):
                await dial(world)
            token = re.findall(r"ws://\S+/(\w+)", caplog.text)[0]
            async with dial(world, f"/{token}") as connection:
                await Peer(connection).text("serverInfo")

    asyncio.run(asyncio.wait_for(whole(), 120.0))
    assert "one was made for this run" in caplog.text


def test_silent_strangers_have_few_places_and_the_oldest_makes_way() -> None:
    async def whole() -> None:
        world = context()
        async with running(world):
            port = int(world.stats.address.rpartition(":")[2])
            silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(70)]
            assert await asyncio.wait_for(silent[0][0].read(), 60.0) == b""
            async with dial(world) as connection:
                await Peer(connection).text("serverInfo")
            refused: Any = world.stats.details["refused"]
            assert refused["strangers"] >= 6
            for _, writer in silent:
                writer.close()

    asyncio.run(asyncio.wait_for(whole(), 120.0))
