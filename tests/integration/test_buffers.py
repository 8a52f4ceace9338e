"""A camera and a modem that only this test has: buffers, bytes and texts through every adapter both ways, and through a recording."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import msgpack
import numpy as np
import pytest
import uwclient
from mcap.reader import make_reader
from test_replay import Rig, rewritten
from uwserver_adapters.moos.bridge.bridge import ERROR, Bridge
from uwserver_adapters.moos.config import BridgeTable
from uwserver_adapters.native.codec import JsonCodec, MsgpackCodec
from uwserver_adapters.native.messages import Request as SocketRequest
from uwserver_adapters.sockets import SocketsAdapter
from websockets.asyncio.client import connect as connect_websocket

from uwserver.ports import Buffer, Command, Field, Items, Layout, Port, Refused, Sample
from uwserver.ports.checks import check_given, check_values, checked_command
from uwserver.recording import replay as replay_module
from uwserver.recording.format import REQUESTS
from uwserver.recording.replay import NotReplayable, replay
from uwserver.scenario.build.world import build
from uwserver.sensors import IdealSensor
from uwserver.simulation.clock import Timing
from uwserver.testing import FakeContext
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.state import snapshot
from uwserver.world.stepping.commands import ActuatorSlot
from uwserver.world.world import World

PICTURE = Field("picture", "1", "what it saw", type="buffer", buffer=Layout("float32", (-1, 4)))
CAMERA = Port("rov/camera", "sensor", "camera", (PICTURE,), "Camera.", rate_hz=10.0)
HEARD = Port(
    "rov/heard", "sensor", "heard",
    (Field("payload", "1", "bytes", type="bytes"), Field("from", "1", "sender", type="str"), PICTURE), "What came.", 10.0,
)  # fmt: skip
MODEM = Port(
    "rov/modem", "actuator", "modem",
    (
        Field("to", "1", "receiver", type="str"),
        Field("payload", "1", "what to send", type="bytes", max_bytes=1000),
        Field("picture", "1", "a picture to send", type="buffer", buffer=Layout("uint8", (-1, 3))),
    ),
    "Modem.",
)  # fmt: skip
SPEAKER = Port("rov/speaker", "actuator", "speaker", (Field("payload", "1", "raw", type="bytes"),), "Speaker.")
SEEN = Buffer.of(np.array([[0.0, np.nan, -np.inf, 1.5], [1e-30, 2, 3, 4]], np.float32))
PIXELS = np.arange(6, dtype=np.uint8).reshape(2, 3)
PAYLOAD = bytes(range(256))
TWO = Buffer(data=b"\0\1")
GIVEN: Items = ("süd", Buffer(data=PAYLOAD), Buffer.of(PIXELS))
SAMPLES = (
    Sample(CAMERA.path, 1, 5, 6, True, (SEEN,)),
    Sample(HEARD.path, 1, 5, 6, True, (Buffer(data=PAYLOAD), "nörd", SEEN)),
    Sample(HEARD.path, 2, 7, 8, False, (None, None, None)),
)
PATIENCE_S = 120.0
HAS_ZENOH = importlib.util.find_spec("zenoh") is not None


def context() -> FakeContext:
    return FakeContext(ports={port.path: port for port in (CAMERA, HEARD, MODEM, SPEAKER)})


@asynccontextmanager
async def serving(adapter: type[Any], **config: object) -> AsyncIterator[FakeContext]:
    """An adapter with the camera and the modem, ready."""
    fake, ready = context(), asyncio.Event()
    task = asyncio.ensure_future(adapter(adapter.Config(**config), fake).run(ready))
    try:
        await asyncio.wait_for(ready.wait(), PATIENCE_S)
        yield fake
        assert not task.done()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def bounded(work: Awaitable[None]) -> None:
    async def within() -> None:
        await asyncio.wait_for(work, 2 * PATIENCE_S)

    asyncio.run(within())


async def converse(client: uwclient.AsyncClient, fake: FakeContext, heard: Callable[[], Awaitable[None]]) -> None:
    """Everything both ways, and a fault told, by the Python client."""
    await client.subscribe("rov/*")
    await heard()
    fake.put(SAMPLES)
    picture = await client.read(CAMERA.path)
    assert picture["picture"] == uwclient.Buffer("float32", (2, 4), SEEN.data)
    np.testing.assert_array_equal(picture.array("picture"), SEEN.array())
    news, nothing = await client.read(HEARD.path), await client.read(HEARD.path)
    assert (news["payload"], news["from"], news["picture"]) == (PAYLOAD, "nörd", picture["picture"])
    assert dict(nothing.value) == {"payload": None, "from": None, "picture": None}
    for pixels in (PIXELS, uwclient.Buffer.of(PIXELS), PIXELS.tobytes()):
        await client.send(MODEM.path, to="süd", payload=PAYLOAD, picture=pixels)
        assert fake.commands[-1].value == GIVEN
    await client.send(SPEAKER.path, payload=memoryview(b"\0\1"))
    assert fake.commands[-1].value == (TWO,)
    for wrong, code in (
        ({"payload": bytes(1001)}, "too_large"),
        ({"payload": "text"}, "bad_argument"),
        ({"picture": PIXELS.T.copy()}, "bad_shape"),
        ({"picture": {"dtype": "uint9", "shape": [2, 3], "base64": "YWJjZGVm"}}, "bad_argument"),
        ({"picture": {"dtype": "uint8", "shape": [-2, -3], "base64": "YWJjZGVm"}}, "bad_argument"),
        ({"picture": {"dtype": "uint8", "shape": [2, 3], "base64": "@@@@"}}, "bad_argument"),
    ):
        with pytest.raises(uwclient.CallRefused) as refused:
            await client.send(MODEM.path, wrong)
        assert refused.value.code == code
    assert len(fake.commands) == 4


async def at_once() -> None:
    """What is subscribed is heard."""


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_tcp(encoding):
    async def whole() -> None:
        async with serving(SocketsAdapter, port=0) as fake:
            host, port = fake.stats.address.split(":")
            async with await uwclient.AsyncClient.connect(host, int(port), encoding=encoding) as client:
                await converse(client, fake, at_once)

    bounded(whole())


def test_websocket():
    picture = {"dtype": "float32", "shape": [2, 4], "data": SEEN.data}

    async def whole() -> None:
        async with serving(SocketsAdapter, port=0) as fake, connect_websocket(f"ws://{fake.stats.address}") as peer:
            await peer.send(msgpack.packb({"id": 1, "method": "subscribe", "params": {"pattern": "rov/heard"}}))
            await peer.recv()
            fake.put(SAMPLES)
            told = msgpack.unpackb(await peer.recv())["params"]["value"]
            assert told == {"payload": PAYLOAD, "from": "nörd", "picture": picture}
            pixels = {"dtype": "uint8", "shape": [2, 3], "data": PIXELS.tobytes()}
            value = {"to": "süd", "payload": PAYLOAD, "picture": pixels}
            await peer.send(
                msgpack.packb({"id": 2, "method": "command", "params": {"port": MODEM.path, "value": value}})
            )
            while msgpack.unpackb(await peer.recv()).get("id") != 2:
                pass
            assert fake.commands[-1].value == GIVEN

    bounded(whole())


def test_udp():
    async def whole() -> None:
        async with serving(SocketsAdapter, port=0, udp_port=0) as fake:
            host, _, port = str(fake.stats.details["udp"]).rpartition(":")
            loop = asyncio.get_running_loop()
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
                peer.setblocking(False)
                peer.connect((host, int(port)))

                async def ask(method: str, **params: object) -> Any:
                    peer.send(json.dumps({"id": 1, "method": method, "params": params}).encode())
                    return json.loads(await loop.sock_recv(peer, 1 << 16))

                cookie = (await ask("hello", version=1))["cookie"]
                await ask("hello", version=1, cookie=cookie)
                await ask("subscribe", pattern=CAMERA.path)
                fake.put(SAMPLES[:1])
                told = json.loads(await loop.sock_recv(peer, 1 << 16))["params"]["value"]["picture"]
                assert uwclient.buffers.unpacked(told) == uwclient.Buffer("float32", (2, 4), SEEN.data)
                await ask("command", port=SPEAKER.path, value={"payload": {"base64": "AAE="}})
                assert fake.commands[-1].value == (TWO,)

    bounded(whole())


@pytest.mark.skipif(not HAS_ZENOH, reason="eclipse-zenoh is not installed")
@pytest.mark.parametrize("served", ["json", "msgpack"])
@pytest.mark.parametrize("spoken", ["json", "msgpack"])
def test_zenoh(served, spoken):
    from uwserver_adapters.zenoh_bus import ZenohAdapter

    listen = {"listen": ("tcp/127.0.0.1:0",), "scouting": False}

    async def whole() -> None:
        async with serving(ZenohAdapter, encoding=served, **listen) as fake:
            connected = await uwclient.connect_zenoh_async(
                "uwserver", [fake.stats.address], encoding=spoken, timeout=PATIENCE_S
            )
            async with connected as client:
                # Zenoh tells of a subscriber a little later than it has one: samples that come before are not the test's.
                async def heard() -> None:
                    while client.latest(CAMERA.path) is None or client.latest(HEARD.path) is None:
                        fake.put(
                            [
                                Sample(path, 0, 0, 0, True, (None,) * n)
                                for path, n in ((CAMERA.path, 1), (HEARD.path, 3))
                            ]
                        )
                        await asyncio.sleep(0.02)
                    for path in (CAMERA.path, HEARD.path):
                        while (await client.read(path)) is not client.latest(path):
                            pass

                await converse(client, fake, heard)

    bounded(whole())


@pytest.mark.skipif(not HAS_ZENOH, reason="eclipse-zenoh is not installed")
def test_zenoh_raw():
    """A plain peer hears a picture and says a payload as they are."""
    import zenoh
    from uwserver_adapters.zenoh_bus import ZenohAdapter

    async def whole() -> None:
        async with serving(ZenohAdapter, listen=("tcp/127.0.0.1:0",), scouting=False) as fake:
            options = (
                f'{{connect: {{endpoints: ["{fake.stats.address}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
            )
            peer = await asyncio.to_thread(zenoh.open, zenoh.Config.from_json5(options))
            try:
                came: list[Any] = []
                peer.declare_subscriber("uw/uwserver/rov/camera", came.append)
                while not came:
                    fake.put(SAMPLES[:1])
                    await asyncio.sleep(0.02)
                assert came[0].payload.to_bytes() == SEEN.data
                assert str(came[0].encoding) == "application/octet-stream"
                meta = json.loads(came[0].attachment.to_bytes())
                assert (meta["field"], meta["dtype"], meta["shape"], meta["seq"]) == ("picture", "float32", [2, 4], 1)
                block = zenoh.CongestionControl.BLOCK
                peer.put(
                    "uw/uwserver/rov/speaker", PAYLOAD, encoding="application/octet-stream", congestion_control=block
                )
                while not fake.commands:
                    await asyncio.sleep(0.02)
                assert fake.commands[-1].value == (Buffer(data=PAYLOAD),)
            finally:
                peer.close()

    bounded(whole())


def test_moos():
    posts: list[tuple[str, float | str]] = []
    fake = context()

    async def whole() -> None:
        bridge = Bridge(BridgeTable(publish=("**",)), fake, posts.extend, lambda names: None, "moos", lambda: 0.0)
        bridge.put_samples(SAMPLES[:2])
        told = dict(posts)
        assert told["ROV_HEARD_FROM"] == "nörd"
        assert uwclient.buffers.unpacked(json.loads(told["ROV_HEARD_PAYLOAD"])) == PAYLOAD
        assert uwclient.buffers.unpacked(json.loads(told["ROV_CAMERA_PICTURE"])).data == SEEN.data
        bridge.take([("ROV_MODEM_TO", "süd", "app", 1.0), ("ROV_MODEM_PAYLOAD", PAYLOAD, "app", 1.0)])
        bridge.take([("ROV_MODEM_PAYLOAD", json.dumps({"base64": "AAE="}), "app", 1.0)])
        bridge.take([("ROV_MODEM_PICTURE", PIXELS.tobytes(), "app", 1.0)])
        values = [command.value for command in fake.commands]
        assert values == [("süd", None, None), (None, GIVEN[1], None), (None, TWO, None), (None, None, GIVEN[2])]
        posts.clear()
        for name, bad in (
            ("PAYLOAD", "{"),
            ("PAYLOAD", 3.0),
            ("PAYLOAD", '{"base64":"?"}'),
            ("PICTURE", b"\0"),
            ("TO", 1.0),
        ):
            bridge.take([(f"ROV_MODEM_{name}", bad, "app", 1.0)])
        assert [name for name, _ in posts] == [ERROR] * 5
        assert len(fake.commands) == 4
        bridge.close()

    bounded(whole())


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("piece", [1, 7, 1 << 20])
def test_a_command_in_pieces_of_any_size(encoding, piece):
    wire = uwclient.core.Wire(encoding)
    value = {"to": "süd", "payload": PAYLOAD, "picture": uwclient.Buffer.of(PIXELS)}
    _, data = wire.request("command", {"port": MODEM.path, "value": value})
    codec = JsonCodec() if encoding == "json" else MsgpackCodec()
    events = []
    for start in range(0, len(data), piece):
        codec.receive(data[start : start + piece])
        event = codec.next_event()
        events += [event] if isinstance(event, SocketRequest) else []
    (request,) = events
    params: Any = request.params
    assert checked_command(MODEM, params["value"]) == GIVEN


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_garbage_is_refused_and_nothing_else(encoding):
    rng = np.random.default_rng(7)
    value = {"picture": uwclient.Buffer.of(PIXELS), "payload": b"x", "to": "a"}
    _, good = uwclient.core.Wire(encoding).request("command", {"port": MODEM.path, "value": value})
    start = 0 if encoding == "json" else 4
    refused: list[str] = []
    for _ in range(10_000):
        bad = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            bad[rng.integers(start, len(bad) - 1)] = rng.integers(256)
        codec = JsonCodec() if encoding == "json" else MsgpackCodec()
        codec.receive(bytes(bad))
        event: Any = codec.next_event()
        params = event.params if isinstance(event, SocketRequest) else None
        if isinstance(params, dict) and "value" in params:
            try:
                assert len(checked_command(MODEM, params["value"])) == 3
            except Refused as error:
                refused.append(error.fault.text)
    assert len(refused) > 300
    assert max(map(len, refused)) < 500


# -- a recording --------------------------------------------------------------------------------------------------------------------------


class Modem:
    """Keeps what it was told."""

    fields, doc = MODEM.fields, MODEM.doc

    def __init__(self) -> None:
        self.said: list[Items] = []

    def apply(self, value: Items) -> None:
        self.said.append(value)

    def neutral(self) -> None:
        """A modem has none."""


class Camera(IdealSensor):
    """Sees the last picture that the modem was given."""

    fields, doc = HEARD.fields, HEARD.doc

    def __init__(self, modem: Modem) -> None:
        super().__init__()
        self.modem = modem

    def measure(self, scope: object) -> tuple[bool, list[Any]]:
        if not self.modem.said:
            return False, [None, None, None]
        return True, [self.modem.said[-1][1], self.modem.said[-1][0], SEEN]


def equipped(world: World) -> Modem:
    """Give a built world the modem and the camera."""
    modem, member = Modem(), world.members["rov"]
    heard = SensorSlot(Camera(modem), (SensorStream(HEARD),), member.vehicle.row, world.rate_hz, 24, 20_000_000)
    slots = {
        "sensors": (*member.sensors, heard),
        "actuators": (*member.actuators, ActuatorSlot(MODEM, modem, world.rate_hz, 0)),
    }
    world.set_members([replace(member, **slots)])
    return modem


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, list[Modem]]:
    """A run in which the modem was used; worlds that are built from now on have one too."""
    modems: list[Modem] = []

    def built(*args: Any) -> World:
        world = build(*args)
        modems.append(equipped(world))
        return world

    monkeypatch.setattr(replay_module, "build", built)
    rig, path = Rig(Timing("realtime", paused=True)), tmp_path / "run.mcap"
    modems.append(equipped(rig.world))
    with rig.recording(path):
        for value in ({"to": "süd", "payload": PAYLOAD, "picture": PIXELS}, {"payload": {"base64": "AAE="}}):
            rig.post(Command(MODEM.path, checked_command(MODEM, value), "test:1"))
            rig.clock("world/run_until", t_s=(rig.world.tick + 48) / float(rig.world.rate_hz))
    return path, modems


def test_a_recording_holds_them_and_plays_them_again(recorded):
    path, modems = recorded
    outcome = replay(path)
    assert outcome.difference is None
    assert outcome.requests >= 2
    first, again = modems
    assert first.said == again.said == [GIVEN, (None, TWO, None)]


def test_any_tool_can_read_the_recording(recorded):
    path, _ = recorded
    with path.open("rb") as file:
        found = {HEARD.path: [], MODEM.path: [], REQUESTS: []}
        for schema, channel, message in make_reader(file).iter_messages(topics=list(found)):
            entry = json.loads(message.data)
            jsonschema.Draft202012Validator(json.loads(schema.data)).validate(entry)
            found[channel.topic].append(entry)
    heard = next(entry["value"] for entry in found[HEARD.path] if entry["valid"])
    assert heard["payload"] == {"base64": uwclient.buffers.as_text(PAYLOAD)["base64"]}
    assert uwclient.buffers.unpacked(heard["picture"]).array().tobytes() == SEEN.data
    assert found[MODEM.path][1]["value"] == {"to": None, "payload": {"base64": "AAE="}, "picture": None}
    assert found[REQUESTS][0]["value"][0] == "süd"


@pytest.mark.parametrize("bad", [{"base64": "?"}, {"dtype": "uint8", "shape": [9], "base64": "AA=="}, {}])
def test_a_request_that_was_tampered_with_is_refused(bad, recorded, tmp_path):
    path, _ = recorded

    def change(topic: str, entry: dict[str, Any]) -> dict[str, Any]:
        return {**entry, "value": [None, bad, None]} if topic == REQUESTS and entry["port"] == MODEM.path else entry

    rewritten(path, tmp_path / "bad.mcap", change)
    with pytest.raises(NotReplayable, match="cannot be read"):
        replay(tmp_path / "bad.mcap")


def test_a_saved_state_holds_pictures_and_goes_on_the_same():
    """The last reading, a sample under way and the last command, as bytes into another world."""
    worlds = [build(Rig(Timing("realtime", paused=True)).resolved) for _ in range(2)]
    cameras = [equipped(world) for world in worlds]
    here, there = worlds
    here.command(MODEM.path, to="süd", payload=PAYLOAD, picture=PIXELS)
    here.step(49)  # the sample of tick 48 comes 20 ms later
    data = snapshot.to_bytes(here, snapshot.take(here))
    snapshot.from_bytes(there, data)
    cameras[1].said = list(cameras[0].said)  # the modem's own memory is not what is tried here
    assert snapshot.take(there).hash() == snapshot.take(here).hash()
    again = [[sample for sample in world.step(60) if sample.port == HEARD.path] for world in worlds]
    assert again[0] == again[1]
    assert again[0][0].value == (Buffer(data=PAYLOAD), "süd", SEEN)
    assert there.actuators[MODEM.path].last_value == GIVEN


@pytest.mark.parametrize(
    "values",
    [
        (Buffer(data=b""), "x", Buffer(data=bytes(16))),
        (SEEN, "x", SEEN),
        (Buffer(data=b""), "x", Buffer.of(PIXELS)),
        ("text", "x", SEEN),
        (Buffer(data=b""), "x", 1.0),
    ],
)
def test_a_saved_reading_that_is_none_of_the_sensor_is_refused(values):
    check_values(HEARD.fields, SAMPLES[1].value)
    check_values(HEARD.fields, SAMPLES[2].value)
    with pytest.raises(ValueError, match="the wrong type or shape"):
        check_values(HEARD.fields, values)


@pytest.mark.parametrize(
    "given",
    [
        ((1.0,), None, None),
        (None, "text", None),
        (None, Buffer(data=bytes(1001)), None),
        (None, None, SEEN),
        ("x", None),
    ],
)
def test_a_saved_command_that_is_none_of_the_actuator_is_refused(given):
    check_given(MODEM.fields, GIVEN)
    with pytest.raises((ValueError, Refused)):
        check_given(MODEM.fields, given)
    with pytest.raises((ValueError, Refused)):
        check_given((Field("u", "1", "number"),), ("text",))
