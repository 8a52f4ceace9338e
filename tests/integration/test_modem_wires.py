"""Bytes that go into the modem of one vehicle come out of the modem of another, over each wire that carries them: all 256 values of a byte."""

from __future__ import annotations

import base64
import contextlib
import importlib.util
import json
import queue
import socket
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest
from nursery import python
from uwserver_adapters.moos import wire as moos
from uwserver_bench.net.wires import Peer, Refusal, TimedMessage, ZenohPeer, ask, connect
from uwserver_bench.processes import serving

from uwserver.ports import Port
from uwserver.sensors import AcousticModemConfig, Pose
from uwserver.sensors.modem import Modem
from uwserver.world.modems.send import Send

PATIENCE_S = 120.0
PAYLOAD = bytes(range(256))
SHORT = bytes(range(128))
"""Of what carries no more at a time."""
VEHICLES = ("one", "two")

SCENARIO = "schema = 1\n[server]\nmetrics = false\n" + "".join(
    f"""
[vehicles.{name}]
model = "bluerov2_heavy"
position_ned_m = [{90.0 * k}, 0.0, 20.0]
[vehicles.{name}.sensors.modem]
kind = "acoustic_modem"
rate_hz = 1
address = {k + 1}
bits_per_s = 20000
max_bytes = 256
[adapters.moos_{name}]
kind = "moosdb"
port = 0
[adapters.moos_{name}.bridge]
vehicle = "{name}"
"""
    for k, name in enumerate(VEHICLES)
)
TCP = '[adapters.tcp]\nkind = "sockets"\nport = 0\nudp_port = 0\n'
MAVLINK = "".join(
    f'[adapters.mav_{name}]\nkind = "mavlink"\nvehicle = "{name}"\nlinks = ["tcpin:127.0.0.1:0"]\n' for name in VEHICLES
)
ZENOH = '[adapters.zenoh]\nkind = "zenoh"\nlisten = ["tcp/127.0.0.1:0"]\nencoding = "msgpack"\n'
ROS2 = '[adapters.ros2]\nkind = "ros2"\nlisten = ["tcp/127.0.0.1:0"]\ndomain = 0\n'
ROSBRIDGE = '[adapters.rosbridge]\nkind = "rosbridge"\nport = 0\n'


def needs(*modules: str) -> Any:
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    return pytest.mark.skipif(bool(missing), reason=f"not installed: {', '.join(missing)}")


def tables() -> Iterator[str]:
    yield SCENARIO + TCP
    further = {
        MAVLINK: ("pymavlink",),
        ZENOH: ("zenoh",),
        ROS2: ("zenoh", "rosbags"),
        ROSBRIDGE: ("websockets", "rosbags"),
    }
    for text, modules in further.items():
        if all(importlib.util.find_spec(name) for name in modules):
            yield text


@pytest.fixture(scope="module")
def adapters(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mapping[str, Any]]:
    """What `world/status` says of them, while the world runs."""
    file = tmp_path_factory.mktemp("modems") / "modems.toml"
    file.write_text("\n".join(tables()))
    with (
        serving(file, python=python()) as served,
        contextlib.closing(connect("TCP JSON", f"{served.host}:{served.port}")) as driver,
    ):
        yield ask(driver, "call", service="world/status")["value"]["adapters"]


def until(look: Callable[[], Any]) -> Any:
    """What it finds, as soon as it finds something."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if (found := look()) is not None:
            return found
    raise AssertionError("nothing came in time")


def heard(peer: Peer, port: str = "two/modem/received", send: Callable[[], object] = lambda: None) -> Any:
    """The value of the first sample of a port, after something was sent, again and again."""

    def look() -> Any:
        send()
        said = [m.body["params"] for m in peer.receive(1.0) if m.body.get("method") == "sample"]
        return next((each["value"] for each in said if each["port"] == port), None)

    return until(look)


# -- uwserver's own ----------------------------------------------------------------------------------------------------------------------


def own(adapters: Mapping[str, Any], wire: str) -> Peer:
    if wire.startswith("zenoh"):
        return ZenohPeer(adapters["zenoh"]["address"])
    return connect(wire, adapters["tcp"]["details"]["udp"] if wire == "UDP" else adapters["tcp"]["address"])


@pytest.mark.parametrize(
    "wire", ["TCP JSON", "TCP msgpack", "WebSocket", "UDP", pytest.param("zenoh", marks=needs("zenoh"))]
)
def test_own_protocols(adapters, wire):
    with contextlib.closing(own(adapters, wire)) as peer:
        ask(peer, "subscribe", pattern="two/modem/received")
        packed = wire in ("TCP msgpack", "zenoh")
        data: object = PAYLOAD if packed else {"base64": base64.b64encode(PAYLOAD).decode()}

        def send() -> None:
            ask(peer, "command", port="one/modem/send", value={"destination": 2, "data": data})

        if wire == "zenoh":  # the server may not know yet that somebody subscribes
            value = heard(peer, send=send)
        else:
            send()
            value = heard(peer)
    told = value["data"] if packed else base64.b64decode(value["data"]["base64"])
    assert (value["event"], value["source"], value["destination"], told) == ("data", 1, 2, PAYLOAD)


def test_a_range_is_a_call_like_any_other(adapters):
    with contextlib.closing(connect("TCP JSON", adapters["tcp"]["address"])) as peer:
        found = ask(peer, "call", PATIENCE_S, service="one/modem/range", args={"destination": 2})["value"]
        assert found["range"] == pytest.approx(90.0, abs=8.0)  # they rise and drift
        with pytest.raises(Refusal, match=r"no answer from 77 came within 0\.4 s"):
            ask(peer, "call", PATIENCE_S, service="one/modem/range", args={"destination": 77, "timeout_s": 0.4})


def test_a_range_that_is_cancelled_leaves_the_modem_free(adapters):
    with contextlib.closing(connect("TCP JSON", adapters["tcp"]["address"])) as peer:
        peer.send("call", {"service": "one/modem/range", "args": {"destination": 77, "timeout_s": 60.0}}, 1)
        with pytest.raises(Refusal, match="waits for another range"):
            ask(peer, "call", PATIENCE_S, service="one/modem/range", args={"destination": 2})
        seen: list[TimedMessage] = []
        assert ask(peer, "cancel", seen=seen, id=1) == {"cancelled": True}
        found = ask(peer, "call", PATIENCE_S, seen=seen, service="one/modem/range", args={"destination": 2})["value"]
        (fault,) = [message.body["error"]["data"]["code"] for message in seen if message.body.get("id") == 1]
    assert fault == "preempted"
    assert found["range"] == pytest.approx(90.0, abs=12.0)


# -- MOOS --------------------------------------------------------------------------------------------------------------------------------


class Community:
    """A client of the embedded MOOSDB of one vehicle."""

    def __init__(self, address: str, *wanted: str) -> None:
        host, _, port = address.rpartition(":")
        self.socket = socket.create_connection((host, int(port)), PATIENCE_S)
        self._decoder = moos.Decoder()
        hello = moos.MoosMessage(moos.DATA, moos.ASYNCHRONOUS, data=b"acomms", kind=moos.STRING)
        self.socket.sendall(moos.HELLO + moos.packet([moos.encode(hello)]))
        for name in wanted:
            pattern = f"AppPattern=*,VarPattern={name},Interval=0".encode()
            asked = moos.MoosMessage(moos.WILDCARD_REGISTER, "acomms", data=pattern, kind=moos.STRING)
            self.socket.sendall(moos.packet([moos.encode(asked)]))
        self.heard: list[tuple[str, float | str | bytes]] = []

    def write(self, name: str, value: float | str | bytes) -> None:
        self.socket.sendall(moos.packet([moos.encode(moos.notify(name, value, time.time(), "acomms"))]))

    def wait(self, name: str, accept: Callable[[Any], bool]) -> dict[str, Any]:
        """Until a variable comes with such a value; the newest of all that came."""
        self.socket.settimeout(0.1)

        def look() -> dict[str, Any] | None:
            with contextlib.suppress(TimeoutError):
                self._decoder.receive(self.socket.recv(1 << 20))
            while isinstance(event := self._decoder.next_event(), moos.Packet | moos.Reading):
                if isinstance(event, moos.Packet):
                    self.heard += [(said.key, said.value) for said in event.messages if said.type == moos.NOTIFY]
            told = dict(self.heard)
            return told if name in told and accept(told[name]) else None

        found: dict[str, Any] = until(look)
        return found

    def close(self) -> None:
        self.socket.close()


def test_moos(adapters):
    one, two = (Community(adapters[f"moos_{name}"]["address"], "ACOMMS_RECEIVED*") for name in VEHICLES)
    with contextlib.closing(one), contextlib.closing(two):
        one.write("ACOMMS_TRANSMIT_DEST", 2.0)
        one.write("ACOMMS_TRANSMIT_DATA", "over the water")
        told = two.wait("ACOMMS_RECEIVED_DATA", lambda value: value == "over the water")
        assert (told["ACOMMS_RECEIVED_SOURCE_ID"], told["ACOMMS_RECEIVED_DEST_ID"]) == (1.0, 2.0)
        two.write("ACOMMS_TRANSMIT_DATA_BINARY", PAYLOAD)
        packed = one.wait("ACOMMS_RECEIVED_DATA", lambda value: str(value).startswith("{"))
    assert base64.b64decode(json.loads(packed["ACOMMS_RECEIVED_DATA"])["base64"]) == PAYLOAD
    assert (packed["ACOMMS_RECEIVED_SOURCE_ID"], packed["ACOMMS_RECEIVED_DEST_ID"]) == (2.0, 255.0)


# -- MAVLink -----------------------------------------------------------------------------------------------------------------------------


class Companion:
    """A computer on a vehicle."""

    def __init__(self, address: str) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        host, _, port = address.removeprefix("tcpin:").rpartition(":")
        self.socket = socket.create_connection((host, int(port)), PATIENCE_S)
        self.socket.settimeout(0.1)
        self.mav = ardupilotmega.MAVLink(self, srcSystem=255, srcComponent=190)
        self.mav.heartbeat_send(6, 8, 0, 0, 0)

    def write(self, data: bytes) -> None:
        self.socket.sendall(data)

    def tunnel(self) -> Any:
        """The next TUNNEL; None where none is there."""
        data = b""
        with contextlib.suppress(TimeoutError):
            data = self.socket.recv(1 << 16)
        found = self.mav.parse_buffer(data) or []
        return next((message for message in found if message.get_type() == "TUNNEL"), None)

    def close(self) -> None:
        self.socket.close()


@needs("pymavlink")
def test_mavlink(adapters):
    one, two = (Companion(adapters[f"mav_{name}"]["address"]) for name in VEHICLES)
    with contextlib.closing(one), contextlib.closing(two):
        assert two.tunnel() is None
        one.mav.tunnel_send(0, 0, 32768 + 2, len(SHORT), list(SHORT))
        came = until(two.tunnel)
        assert (came.payload_type, came.payload_length) == (32768 + 1, 128)
        assert bytes(came.payload) == SHORT
        two.mav.tunnel_send(0, 0, 0, 3, [*b"\0ok", *bytes(125)])  # to all
        back = until(one.tunnel)
    assert (back.payload_type, bytes(back.payload[: back.payload_length])) == (32768 + 2, b"\0ok")


# -- ROS ---------------------------------------------------------------------------------------------------------------------------------


@needs("websockets", "rosbags")
def test_rosbridge(adapters):
    from websockets.sync.client import connect as open_socket

    with open_socket(adapters["rosbridge"]["address"], max_size=None) as stream:
        stream.send(json.dumps({"op": "subscribe", "topic": "/two/modem/received"}))
        stream.send(json.dumps({"op": "call_service", "service": "/rosapi/get_time", "id": "asked"}))
        until(lambda: True if json.loads(stream.recv(PATIENCE_S)).get("id") == "asked" else None)
        message = {"destination": 2.0, "data": base64.b64encode(PAYLOAD).decode(), "acknowledge": 0.0}
        stream.send(json.dumps({"op": "publish", "topic": "/one/modem/send/cmd", "msg": message}))

        def look() -> Any:
            said = json.loads(stream.recv(PATIENCE_S))
            assert said["op"] != "status", said
            return said["msg"] if said["op"] == "publish" else None

        told = until(look)
    data = base64.b64decode(told["data"]) if isinstance(told["data"], str) else bytes(told["data"])
    assert (told["event"], told["source"], told["destination"], data) == ("data", 1, 2, PAYLOAD)


@needs("zenoh", "rosbags")
def test_ros2(adapters):
    """By the keys of rmw_zenoh and CDR, with the types that uwserver_msgs has for modems."""
    import numpy as np
    import zenoh
    from uwserver_adapters.ros.messages import Types
    from uwserver_adapters.ros.messages.generated import definition, generated_type
    from uwserver_adapters.ros.messages.types import dds_name

    types = Types("jazzy")
    modem = AcousticModemConfig(rate_hz=1, bits_per_s=20000, max_bytes=256).build(Pose())
    out = Port("two/modem/received", "sensor", "acoustic_modem", Modem.fields, Modem.doc, 1.0, message="AcousticPacket")
    sender = Send(modem, lambda *message: None, lambda: 0.0)
    into = Port("one/modem/send", "actuator", "acoustic_modem", sender.fields, sender.doc)
    heard_type = generated_type(types, out, definition(out))
    send_type = generated_type(types, into, definition(into, is_command=True), "Command")
    config = zenoh.Config()
    endpoint = adapters["ros2"]["address"]
    for path, value in {"mode": '"client"', "connect/endpoints": f'["{endpoint}"]', "scouting/multicast/enabled": "false"}.items():  # fmt: skip
        config.insert_json5(path, value)

    def key(topic: str, kind: str) -> str:
        return f"0/{topic}/{dds_name(kind)}/{types.hash(kind)}"

    with zenoh.open(config) as session:
        came: queue.Queue[bytes] = queue.Queue()
        session.declare_subscriber(key("two/modem/received", heard_type), lambda s: came.put(s.payload.to_bytes()))
        given = types.make(send_type, destination=2.0, data=np.frombuffer(PAYLOAD, np.uint8), acknowledge=0.0)
        meta = struct.pack("<qqB16s", 1, time.time_ns(), 16, bytes(16))

        def look() -> bytes | None:  # the server may not know yet that somebody subscribes
            block = zenoh.CongestionControl.BLOCK
            session.put(
                key("one/modem/send/cmd", send_type), types.cdr(given), attachment=meta, congestion_control=block
            )
            with contextlib.suppress(queue.Empty):
                return came.get(timeout=1.0)
            return None

        told = types.from_cdr(until(look), heard_type)
    assert (told.event, told.source, told.destination, bytes(told.data)) == ("data", 1, 2, PAYLOAD)
