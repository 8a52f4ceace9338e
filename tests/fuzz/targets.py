"""What is fuzzed: each target makes one input, gives it to a codec, and asserts what must hold of the answer. No sockets."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import re
import struct
from collections.abc import Callable, Mapping
from typing import Any

import devices_rig
import msgpack
from dice import Dice
from msgspec import structs
from uwserver_adapters.ardupilot import wire as ardupilot
from uwserver_adapters.devices import device as devices
from uwserver_adapters.devices import (
    oculus,
    ping360,
    ping_protocol,
    seatrac,
    seatrac_messages,
    vectornav,
    vectornav_messages,
    water_linked_a50,
    xsens,
)
from uwserver_adapters.mavlink.wire import frames as mavlink_frames
from uwserver_adapters.mavlink.wire.dialect import Dialect
from uwserver_adapters.mavlink.wire.json_form import BadJson, frame_of
from uwserver_adapters.moos import wire as moos
from uwserver_adapters.moos.text import lines as moos_text
from uwserver_adapters.morse import grammar as morse
from uwserver_adapters.native.codec import Control, JsonCodec, MsgpackCodec
from uwserver_adapters.native.messages import Malformed, Request
from uwserver_adapters.native.websocket import Handshake, WebSocketCodec
from uwserver_adapters.player import codec as player_codec
from uwserver_adapters.player import wire as player
from uwserver_adapters.px4 import codec as px4
from uwserver_adapters.ros1 import wire as tcpros
from uwserver_adapters.ros1 import xmlrpc
from uwserver_adapters.sil.in_the_loop import Scale
from uwserver_adapters.sockets import SocketsAdapter
from uwserver_adapters.sockets.connection import Connection
from uwserver_adapters.video import camera as video_camera
from uwserver_adapters.video import rtsp, session
from uwserver_adapters.yarp import bottle as yarp_bottle
from uwserver_adapters.yarp import codec as yarp_codec
from uwserver_adapters.yarp import wire as yarp
from uwserver_adapters.zenoh_bus.codec import Codec as ZenohCodec
from uwserver_adapters.zenoh_bus.keys import KeyScheme
from uwserver_adapters.zenoh_bus.requests import Put, Question, Requests

from uwserver.adapter import AdapterStats, Refusals
from uwserver.physics.geometry.shapes import BadSolid
from uwserver.ports import Buffer, Field, Port, Refused
from uwserver.scenario.solids.appearance import check_glb
from uwserver.sensors.optical.camera.gltf import BadGltf, read_glb
from uwserver.server.http import Service
from uwserver.testing import FakeContext, Loopback
from uwserver.testing.codecs import read_all
from uwserver.testing.fake_context import SERVICES, THRUSTERS

MESSAGES: list[Any] = [
    {"jsonrpc": "2.0", "id": 1, "method": "hello", "params": {"version": 1, "name": "pilot", "token": "x"}},
    {"jsonrpc": "2.0", "id": 2, "method": "describe", "params": {"pattern": "rov/*"}},
    {"jsonrpc": "2.0", "id": "s", "method": "subscribe", "params": {"pattern": "**", "rate_hz": 10.5, "delivery": "latest"}},
    {"jsonrpc": "2.0", "id": 4, "method": "unsubscribe", "params": {"subscription": 1}},
    {"jsonrpc": "2.0", "id": 6, "method": "command", "params": {"port": "rov/thrusters", "value": {"u": [0.1, -0.2, 1, -1, 0, 0, 1e-9, 0.5]}}},
    {"jsonrpc": "2.0", "id": 7, "method": "call", "params": {"service": "world/echo", "args": {"value": [None, True, {"a": "\u00e9"}]}}},
    {"jsonrpc": "2.0", "id": 8, "method": "call", "params": {"service": "world/run_until", "args": {"t_s": 5.0}}},
    {"jsonrpc": "2.0", "id": 9, "method": "step", "params": {"n": 3}},
    {"jsonrpc": "2.0", "id": 10, "method": "cancel", "params": {"id": 8}},
    {"jsonrpc": "2.0", "id": -(2**63), "method": "ping", "params": [2**64 - 1, 1e300, -0.0, "x" * 300]},
]  # fmt: skip
MORSE: list[Any] = [
    ["simulation", "details", []],
    ["simulation", "get_stream_port", "rov.imu"],
    ["rov.waypoint", "goto", 1.5],
    ["cancel"],
    ["time", "sleep", {"a": [1e300, None, True]}],
]
TCPROS = [
    tcpros.header(
        {"callerid": "/rviz", "topic": "/rov/imu", "md5sum": "*", "type": "sensor_msgs/Imu", "tcp_nodelay": "1"}
    ),
    tcpros.header({"service": "/world/pause"}) + tcpros.block(b"") * 3,
]
XMLRPC = [
    xmlrpc.request("127.0.0.1:5000", "/RPC2", "requestTopic", ["/rviz", "/rov/imu", [["TCPROS"]]]),
    xmlrpc.request("localhost", "/", "publisherUpdate", ["/m", "/t", ["http://h:1/"]]) * 2,
]
RUN_UNTIL = next(service for service in SERVICES if service.path == "world/run_until")
ECHO = next(service for service in SERVICES if service.path == "world/echo")
FOLLOWER = {"jsonrpc": "2.0", "id": 2, "method": "describe", "params": {"pattern": "rov/*"}}
_PATIENCE = 2000
FOLLOWED = Request(2, "describe", {"pattern": "rov/*"})


def texts(events: list[Any]) -> list[str]:
    """For comparing, because NaN is not equal to itself. Whose a frame without end was is told as far as its head has come: without the id."""
    return [repr(structs.replace(e, id=None) if isinstance(e, Malformed) and e.fatal else e) for e in events]


class Target:
    """One kind of input."""

    def __init__(self, dice: Dice) -> None:
        self._dice = dice

    def once(self) -> None:
        """One input, and what must hold."""
        raise NotImplementedError

    def close(self) -> None:
        """No input more."""


class InLoop(Target):
    """One whose answers come with turns of a loop."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._loop = asyncio.new_event_loop()
        self._context = FakeContext()

    async def _once(self) -> None:
        raise NotImplementedError

    def once(self) -> None:
        """One input, with as many turns as it needs."""
        self._loop.run_until_complete(self._once())
        self._context.calls.clear()
        self._context.commands.clear()
        self._context.described.clear()

    def close(self) -> None:
        """The loop ends."""
        self._loop.close()


def id_of(message: Any) -> Any:
    """The id under which a request must be answered; None for none."""
    found = message.get("id") if isinstance(message, dict) else None
    if isinstance(found, str):
        return found if len(found) <= 256 else None
    return found if isinstance(found, int) and not isinstance(found, bool) and -(2**63) <= found < 2**64 else None


class Json(Target):
    """JSON lines: one event a line, under the id of its request; a broken one costs no other."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._follower = json.dumps(FOLLOWER).encode() + b"\n"

    def once(self) -> None:
        dice = self._dice
        message = dice.tree(dice.one(MESSAGES))
        data = json.dumps(message, ensure_ascii=bool(dice.below(2))).encode() + b"\n"
        if dice.below(2):
            events = read_all(JsonCodec(), dice.pieces(data + self._follower), None)
            assert len(events) == 2, data
            assert events[0].id == id_of(message), (data, events[0])
        else:
            data = dice.damaged(data)
            events = read_all(JsonCodec(), [data, b"\n", self._follower], None)
            in_pieces = read_all(JsonCodec(), [*dice.pieces(data), b"\n" + self._follower], None)
            assert texts(in_pieces) == texts(events), data
            assert len(events) <= data.count(b"\n") + 2, data
            assert all(isinstance(event, Request | Malformed) for event in events)
        assert events[-1] == FOLLOWED, data


def packed(message: Any) -> bytes:
    """One msgpack map in its frame."""
    body: bytes = msgpack.packb(message, unicode_errors="surrogatepass")
    return struct.pack(">I", len(body)) + body


class Msgpack(Target):
    """msgpack in frames: while the lengths are right, one event a frame."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._follower = packed(FOLLOWER)

    def once(self) -> None:
        dice = self._dice
        message = dice.tree(dice.one(MESSAGES))
        data = packed(message)
        kind = dice.below(3)
        if kind == 0:  # the body is another, the frame as it should be
            body = dice.damaged(data[4:])
            data = struct.pack(">I", len(body)) + body
        if kind < 2:
            events = read_all(MsgpackCodec(), dice.pieces(data + self._follower), None)
            assert len(events) == 2, data
            assert events[1] == FOLLOWED
            assert kind == 0 or events[0].id == id_of(message), (data, events[0])
        else:
            data = dice.damaged(data)
            events = read_all(MsgpackCodec(), [data], None)
            assert texts(read_all(MsgpackCodec(), dice.pieces(data), None)) == texts(events), data
            assert all(isinstance(event, Request | Malformed) for event in events)


class WebSocket(Target):
    """Messages and frames after a handshake; control frames in between, wrong ones end the conversation."""

    _HELLO = (
        b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._codec = self._open()

    def _open(self) -> WebSocketCodec:
        handshake = Handshake(("*",), ())
        handshake.receive(self._HELLO)
        assert handshake.codec is not None
        return handshake.codec

    @staticmethod
    def frame(body: bytes, opcode: int, fin: bool = True) -> bytes:
        """A client's frame, masked with zeros."""
        size = len(body)
        length = bytes((0x80 | size,)) if size < 126 else bytes((0x80 | 126,)) + struct.pack(">H", size)
        return bytes((opcode | (0x80 if fin else 0),)) + length + bytes(4) + body

    def once(self) -> None:
        dice = self._dice
        message = dice.tree(dice.one(MESSAGES))
        is_text = bool(dice.below(2))
        body = json.dumps(message).encode() if is_text else packed(message)[4:]
        opcode = 1 if is_text else 2
        kind = dice.below(4)
        if kind == 0:
            data = self.frame(body, opcode)
        elif kind == 1:  # in fragments, with a ping between them
            cut = dice.below(len(body) + 1)
            data = self.frame(body[:cut], opcode, fin=False) + self.frame(b"?", 9) + self.frame(body[cut:], 0)
        elif kind == 2:
            data = self.frame(dice.damaged(body)[:60000], opcode)
        else:
            data = dice.damaged(self.frame(body, opcode))
        events = read_all(self._codec, dice.pieces(data), None)
        assert all(isinstance(event, Request | Malformed | Control) for event in events)
        if kind < 2:
            requests = [event for event in events if not isinstance(event, Control)]
            assert len(requests) == 1, data
            assert requests[0].id == id_of(message), (data, requests)
        is_over = any(event.ends if isinstance(event, Control) else getattr(event, "fatal", False) for event in events)
        if kind == 3 or is_over:
            self._codec = self._open()


class Mavlink(Target):
    """Frames of MAVLink: no byte is lost or told twice, and a whole frame after garbage is found."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._dialect = Dialect()
        self._layouts = list(self._dialect.by_id.values())
        self._good = mavlink_frames.pack(self._dialect, 0, bytes(9), 1, 1, 1)

    def once(self) -> None:
        dice = self._dice
        layout = dice.one(self._layouts)
        payload = dice.bytes(255).rstrip(b"\0") or b"\0"
        numbers = dice.below(256), dice.below(256), dice.below(256)
        frame = mavlink_frames.pack(self._dialect, layout.id, payload, *numbers)
        decoder = mavlink_frames.Decoder(self._dialect)
        if dice.below(2):
            events = read_all(decoder, dice.pieces(frame), None)
            assert [event.raw for event in events] == [frame]
            found = events[0]
            assert (found.id, found.payload, found.seq, found.system, found.component) == (layout.id, payload, *numbers)
            told = layout.decode(found.payload, found.system, found.component)
            again = layout.decode(layout.encode(told.fields), 1, 1).fields
            assert repr(layout.decode(layout.encode(again), 1, 1).fields) == repr(again), frame
            return
        data = dice.damaged(frame) + bytes(300) + self._good
        events = read_all(decoder, dice.pieces(data), None)
        sizes = [len(event.raw) if isinstance(event, mavlink_frames.Frame) else event.size for event in events]
        assert sum(sizes) == len(data), data
        assert isinstance(events[-1], mavlink_frames.Frame), data
        assert events[-1].raw == self._good, data


class MavlinkJson(Target):
    """MAVLink as JSON: a frame or a reason."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._dialect = Dialect()
        header = {"system_id": 1, "component_id": 1, "sequence": 7}
        self._messages = [
            {"header": header, "message": {"type": "HEARTBEAT", "custom_mode": 3, "mavtype": {"type": "MAV_TYPE_GCS"}, "base_mode": {"bits": 81}}},
            {"header": header, "message": {"type": "COMMAND_LONG", "param1": 1.0, "param2": None, "command": {"type": "MAV_CMD_DO_SET_MODE"}}},
            {"header": header, "message": {"type": "PARAM_SET", "param_id": ["A", "B", "\0"], "param_value": 1e9}},
            {"header": header, "message": {"type": "RC_CHANNELS_OVERRIDE", "chan1_raw": 1500}},
            {"header": header, "message": {"type": "TUNNEL", "payload": [1, 2, 3], "payload_length": 3}},
        ]  # fmt: skip

    def once(self) -> None:
        data = json.dumps(self._dice.tree(self._dice.one(self._messages))).encode()
        if self._dice.below(3) == 0:
            data = self._dice.damaged(data)
        try:
            frame = frame_of(data, self._dialect)
        except BadJson:
            return
        (event,) = read_all(self._decoder(), [frame], None)
        assert event.raw == frame, data

    def _decoder(self) -> mavlink_frames.Decoder:
        return mavlink_frames.Decoder(self._dialect)


class MoosPackets(Target):
    """MOOS packets: what is understood is what was sent, byte for byte; after a fault nothing comes any more."""

    def _message(self) -> bytes:
        dice = self._dice
        texts = [dice.bytes(12).decode("utf-8", "surrogateescape") for _ in range(4)]
        numbers = [dice.one((0.0, -1.0, math.nan, math.inf, 1e308, 1234.5)) for _ in range(3)]
        made = moos.MoosMessage(
            dice.one("NRU*/iWKTQ.C\xff"), texts[0], numbers[0], dice.bytes(40), dice.one("DSB?"), *texts[1:],
            numbers[1], numbers[2], dice.one((-2, -1, 0, 2**31 - 1)),
        )  # fmt: skip
        return moos.encode(made)

    def once(self) -> None:
        dice = self._dice
        messages = [self._message() for _ in range(dice.below(4))]
        data = moos.packet(messages)
        follower = moos.packet([moos.encode(moos.notify("DEPTH", 1.5, 2.0))])
        if dice.below(2):
            events = read_all(moos.Decoder(), dice.pieces(data + follower), None)
            assert len(events) == 2, data
        else:
            data = dice.damaged(data)
            events = read_all(moos.Decoder(), [data + follower], None)
            in_pieces = read_all(moos.Decoder(), dice.pieces(data + follower), None)
            assert repr(in_pieces) == repr(events), data
        at = 0
        for event in events[:-1]:
            assert isinstance(event, moos.Packet), data
        for event in events:
            if isinstance(event, moos.Packet):
                again = moos.packet([moos.encode(message) for message in event.messages])
                assert (data + follower)[at : at + len(again)] == again, data
                at += len(again)
                for message in event.messages:
                    assert isinstance(message.value, float | str | bytes)
                    moos.wildcard_of(message)


class MoosLines(Target):
    """Lines of text: one answer a line, under its tag; the next line is understood."""

    _LINES = (
        b"DEPTH=1.5 SPEED=2", b'#t1 NAME="a \\" b",X=-1e-3;Y=.5', b"SUBSCRIBE NAV_* 5", b"#7 CALL rov/autopilot/arm {}", b"GET DEPTH",
        b"HELP", b"unsubscribe *", b"#a X=1 Y=2 Z=3", b"",
    )  # fmt: skip

    def once(self) -> None:
        dice = self._dice
        tag = f"{dice.below(1 << 30)}"
        body = dice.damaged(dice.one(self._LINES)).replace(b"\n", b"")
        line = b"#" + tag.encode() + b" " + body
        data = line + dice.one((b"\n", b"\r\n")) + b"#end X=1\n"
        events = read_all(moos_text.LineDecoder(), dice.pieces(data), None)
        assert len(events) == 2, data
        assert events[0].tag == tag or isinstance(events[0], moos_text.Malformed), (data, events[0])
        assert events[1] == moos_text.Write((("X", 1.0),), "end"), data
        if isinstance(events[0], moos_text.Write):
            for name, value in events[0].pairs:
                assert name, data
                assert isinstance(value, str) or math.isfinite(value), data


class MorseLines(Target):
    """Requests of MORSE: one answer a line, under its id; the next line is understood."""

    def once(self) -> None:
        dice = self._dice
        tree = dice.tree(dice.one(MORSE))
        line = (
            b"q7 " + " ".join(str(each) for each in tree[:-1]).encode("utf-8", "surrogatepass")
            if isinstance(tree, list) and tree
            else b"q7"
        )
        line += b" " + json.dumps(tree[-1:]).encode() if isinstance(tree, list) else b""
        data = dice.damaged(line).replace(b"\n", b" ") + b"\nend simulation details []\n"
        events = read_all(morse.RequestDecoder(), dice.pieces(data), None)
        assert events == read_all(morse.RequestDecoder(), [data], None), data
        assert events[-1] == morse.Request("end", "simulation", "details"), data
        assert len(events) <= 2, data
        assert all(isinstance(event, morse.Request | morse.Cancel | morse.Malformed) for event in events), data
        for event in events:
            assert morse.answer(event.id, "FAILED", data.decode("latin-1")).count(b"\n") == 1, data


class Tcpros(Target):
    """Headers of TCPROS and calls of XML-RPC: an answer or a refusal, the same in pieces of any size."""

    def once(self) -> None:
        dice = self._dice
        data = dice.damaged(dice.one(TCPROS))
        whole, parts = self._blocks([data]), self._blocks(dice.pieces(data))
        assert whole == parts, data
        for block in whole:
            if isinstance(block, bytes):
                with contextlib.suppress(Refused):
                    fields = tcpros.fields_of(block)
                    assert tcpros.fields_of(tcpros.header(fields)[4:]) == fields
        data = dice.damaged(dice.one(XMLRPC))
        assert self._calls([data]) == self._calls(dice.pieces(data)), data

    def _blocks(self, pieces: list[bytes]) -> list[object]:
        blocks, found = tcpros.Blocks(1 << 12), []
        try:
            for piece in pieces:
                blocks.receive(piece)
                while (block := blocks.next_block()) is not None:
                    found.append(block)
        except Refused as refused:
            found.append(refused.fault.code)
        return found

    def _calls(self, pieces: list[bytes]) -> list[object]:
        requests, found = xmlrpc.Requests(), []
        try:
            for piece in pieces:
                requests.receive(piece)
                while (call := requests.next_call()) is not None or requests.is_parsing:
                    found += [] if call is None else [repr(call)]
        except xmlrpc.BadHttp as bad:
            found.append(bad.status)
        return found


class Yarp(Target):
    """Connections of YARP: messages or a refusal, the same in pieces of any size; a bottle comes back from both of its forms; commands and calls
    are maps or refused."""

    _BOTTLES: tuple[list[Any], ...] = (
        [["u", [0.1] * 8]], [1, 2.5, "a b", b"\1\2", [yarp_bottle.Vocab("list"), [[]]]], ["run_until", ["t_s", 9]], [0.5] * 8,
        ["echo", '{"a": [1, 2.5, null]}'], ["echo", ["value", "[" * 40]],
    )  # fmt: skip

    def once(self) -> None:
        dice = self._dice
        carrier = dice.one(yarp.CARRIERS)
        text = yarp.is_text(carrier)
        bottle = self._bottle(dice.tree(dice.one(self._BOTTLES)))
        said = yarp.payload(text, bottle)
        data = yarp.hello(carrier, "/w") + yarp.message(text, dice.one(("d", "D 5 1.25", "a")), said)
        if dice.below(2):
            events = self._read(dice.pieces(data + yarp.message(text, "q")))
            assert len(events) == 3, data
            assert repr(events[1].values) == repr(bottle), (data, events)
            assert events[2] == yarp.YarpMessage("q", "q", ())
        else:
            data = dice.damaged(data)
            events = self._read([data])
            assert repr(self._read(dice.pieces(data))) == repr(events), data
        for event in events:
            if isinstance(event, yarp.YarpMessage):
                with contextlib.suppress(Refused):
                    assert isinstance(yarp_codec.command(THRUSTERS, event.values), dict)
                with contextlib.suppress(Refused):
                    yarp_codec.call(event.values, {"run_until": RUN_UNTIL, "echo": ECHO})

    def _bottle(self, tree: Any) -> list[Any]:
        """What a bottle can hold of a tree, and nothing that its forms write in another way."""
        if isinstance(tree, dict):
            tree = [*tree.items()]
        return [self._item(each) for each in tree] if isinstance(tree, list | tuple) else [self._item(tree)]

    def _item(self, value: Any) -> Any:
        if isinstance(value, dict | list | tuple):
            return self._bottle(value)
        if value is None or isinstance(value, bool):
            return int(value or 0)
        if isinstance(value, int):
            return max(-(2**63), min(value, 2**63 - 1))
        return value.encode("utf-8", "replace").decode() if type(value) is str else value

    def _read(self, pieces: list[bytes]) -> list[Any]:
        decoder, found = yarp.Decoder(), []
        try:
            for piece in pieces:
                decoder.receive(piece)
                while (event := decoder.next_event()) is not None:
                    fault = getattr(event, "fault", None)
                    found.append(event if fault is None else fault.fault.code)
        except Refused as refused:
            found.append(refused.fault.code)
        return found


class Player(Target):
    """Messages of Player: all of them or a refusal, the same in pieces of any size; what a device is told is an ask or refused."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        state = Port(
            "rov/autopilot/state",
            "sensor",
            "autopilot",
            tuple(Field(n, "1", "x") for n in ("p_N", "q_NB", "v_N", "w_B")),
            "x",
            message="Estimate",
        )
        ports = {port.path: port for port in (state, THRUSTERS)}
        self._devices = [each for each in player_codec.devices_of(ports, 0, "estimate") if each.take is not None]

    def once(self) -> None:
        dice = self._dice
        device = dice.one(self._devices)
        body = dice.one((
            player.octets(json.dumps(dice.tree({"service": "world/pause", "args": {"t_s": 9}})).encode()), player.doubles(*[0.5] * 6) + player.u32(1),
            player.u32(1), dice.bytes(80),
        ))  # fmt: skip
        message = player.PlayerMessage(
            device.interface, device.number, dice.one((2, 3)), dice.one((1, 2, 3)), body, 0.5, 7
        )
        data = player.encode(message)
        if dice.below(2):
            events = self._read(dice.pieces(data + data))
            assert events == [message, message], data
        else:
            data = dice.damaged(data)
            events = self._read([data])
            assert repr(self._read(dice.pieces(data))) == repr(events), data
        for event in events:
            if isinstance(event, player.PlayerMessage):
                assert device.take is not None
                with contextlib.suppress(Refused):
                    assert isinstance(device.take(event), player_codec.Ask)

    def _read(self, pieces: list[bytes]) -> list[Any]:
        decoder, found = player.Decoder(), []
        try:
            for piece in pieces:
                decoder.receive(piece)
                while (event := decoder.next_event()) is not None:
                    found.append(event)
        except Refused as refused:
            found.append(refused.fault.code)
        return found


class ArdupilotFrames(Target):
    """Servo packets: a frame has the very numbers of the packet, everything else is refused."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._scale = Scale()

    def once(self) -> None:
        dice = self._dice
        outputs = dice.one((16, 32))
        magic = ardupilot.MAGIC_16 if outputs == 16 else ardupilot.MAGIC_32
        pwm = [dice.below(1 << 16) for _ in range(outputs)]
        rate, number = dice.below(1 << 16), dice.below(1 << 32)
        data = struct.pack(f"<HHI{outputs}H", magic, rate, number, *pwm)
        if dice.below(2):
            assert ardupilot.parse(data) == ardupilot.Frame(rate, number, tuple(pwm))
            assert all(-1.0 <= self._scale[width] <= 1.0 for width in pwm)
            return
        data = dice.damaged(data)
        found = ardupilot.parse(data)
        if isinstance(found, ardupilot.Frame):
            assert len(data) == 8 + 2 * len(found.pwm), data
            assert found.pwm == struct.unpack_from(f"<{len(found.pwm)}H", data, 8), data
        else:
            assert found in ("bad_magic", "bad_length")


class Px4(Target):
    """PX4's side of MAVLink: outputs are numbers within their limits, and a greeting after garbage is heard."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._mav = px4.mavlink.MAVLink(None, 1, 1)

    def once(self) -> None:
        dice, mav = self._dice, self._mav
        levels = [dice.one((0.0, 1.0, -1.0, math.nan, math.inf, -3e38, 0.3)) for _ in range(16)]
        message = dice.one((
            lambda: mav.hil_actuator_controls_encode(dice.below(1 << 40), levels, dice.below(256), dice.below(1 << 20)),
            lambda: mav.heartbeat_encode(2, 12, 0, 0, 4),
            lambda: mav.command_long_encode(1, 1, dice.one((511, 512)), 0, *levels[:7]),
        ))()  # fmt: skip
        data = bytes(message.pack(mav))
        if dice.below(2):
            data = dice.damaged(data)
        codec = px4.Codec()
        events = [event for piece in dice.pieces(data) for event in codec.receive(piece)]
        for event in events:
            if isinstance(event, px4.Controls):
                assert len(event.levels) == px4.CONTROLS
                assert all(-1.0 <= level <= 1.0 for level in event.levels), data
            elif isinstance(event, px4.Interval):
                assert math.isfinite(event.seconds), data
        codec.receive(bytes(300))
        after = codec.receive(bytes(mav.heartbeat_encode(2, 12, 0, 0, 4).pack(mav)))
        assert after == [px4.Greeting()], data


class Answers:
    """What one question over zenoh got."""

    def __init__(self) -> None:
        self.replies = self.faults = self.ends = 0

    def reply(self, key: str, payload: bytes, media: str, attachment: bytes | None = None) -> None:
        self.replies += 1

    def refuse(self, payload: bytes, media: str) -> None:
        self.faults += 1

    def end(self) -> None:
        self.ends += 1


class Zenoh(InLoop):
    """Puts and gets: every question is answered and ended once, every refused put told once."""

    _MEDIA = ("", "application/json", "application/msgpack", "application/octet-stream", "text/plain", "image/png")
    _PATHS = (
        "rov/thrusters",
        "rov/imu",
        "world/echo",
        "world/run_until",
        "world/status",
        "@describe",
        "@hello",
        "@cancel",
        "rov/none",
        "**",
    )

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._keys = KeyScheme("uw", "s")
        self._told = 0
        codecs: Any = {"json": ZenohCodec("json"), "msgpack": ZenohCodec("msgpack")}
        self._loop.run_until_complete(self._begin(codecs))

    async def _begin(self, codecs: Any) -> None:
        self._requests = Requests(self._context, self._keys, codecs, "json", 60.0, self._tell, lambda: None)

    def _tell(self, key: str, message: object) -> None:
        self._told += 1

    async def _once(self) -> None:
        dice = self._dice
        path = dice.one(self._PATHS)
        value = dice.tree(
            dice.one(({"u": [0.1] * 8}, {"value": {"a": [1, "b"]}}, {"t_s": 5.0}, {"client": "p", "version": 1}))
        )
        media = dice.one(self._MEDIA)
        payload = packed(value)[4:] if media == "application/msgpack" else json.dumps(value).encode()
        caller = json.dumps(dice.tree({"client": "pilot", "id": 5})).encode()
        attachment = dice.one((None, b"", caller, dice.damaged(caller)))
        if dice.below(3) == 0:
            payload = dice.damaged(payload)
        known = {"@describe": self._keys.describe, "@hello": self._keys.hello, "@cancel": self._keys.cancel}
        key = known.get(path) or self._keys.of(path)
        if dice.below(2):
            errors, self._told = self._context.stats.errors, 0
            self._requests.take_put(Put(key, payload, media, attachment, is_delete=dice.below(20) == 0))
            await asyncio.sleep(0)
            assert self._told == self._context.stats.errors - errors, (key, payload, attachment)
            return
        answers = Answers()
        parameters = dice.one(({}, {"timeout_s": "1"}, {"timeout_s": "x"}, {"pattern": "rov/*"}))
        self._requests.take_question(
            Question(key, parameters, payload, media, attachment, answers, lambda other: other == key or "*" in key)
        )
        await asyncio.sleep(0)
        for _ in range(100):  # what asks for many keys is answered in pieces
            if answers.ends:
                break
            await asyncio.sleep(0.001)
        assert answers.ends == 1, (key, payload, attachment)
        assert answers.faults == 0 or (answers.faults, answers.replies) == (1, 0), (key, payload)
        assert answers.faults + answers.replies >= 1, (key, payload)


class Http(Target):
    """/health and /metrics: every head has one answer, with a length that is right."""

    _STATUS = frozenset({"200", "400", "404", "405", "421"})

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        refusals = Refusals("http", AdapterStats(), lambda: 0.0)
        self._service = Service(lambda: {"failure": ""}, lambda: b"x 1\n", ["robot.example"], refusals)

    def once(self) -> None:
        dice = self._dice
        method = dice.one(("GET", "HEAD", "POST", "PRI", "OPTIONS"))
        path = dice.one(("/health", "/metrics", "/", "*", "/../health", "http://evil/health"))
        host = dice.one(("localhost", "127.0.0.1:9", "robot.example", "evil.example", "[::1]:80", ""))
        head = f"{method} {path} HTTP/1.1\r\nHost: {host}\r\nAccept: */*".encode()
        is_whole = bool(dice.below(2))
        if not is_whole:
            head = dice.damaged(head)
        answer = self._service.answer(head)
        top, _, body = answer.partition(b"\r\n\r\n")
        status = top[9:12].decode()
        assert top.startswith(b"HTTP/1.1 "), head
        assert status in self._STATUS, (head, status)
        length = next(line for line in top.lower().split(b"\r\n") if line.startswith(b"content-length:"))
        assert not body or len(body) == int(length.partition(b":")[2]), head
        if is_whole and host in ("evil.example", ""):
            assert status == "421", head
        elif is_whole and method not in ("GET", "HEAD"):
            assert status == "405", head
        elif is_whole:
            assert status == ("200" if path in ("/health", "/metrics") else "404"), head


class Replies(InLoop):
    """Whole connections: each request with an id gets one reply, under this id; what has none gets none."""

    def __init__(self, dice: Dice, is_json: bool) -> None:
        super().__init__(dice)
        self._is_json, self._number = is_json, 0
        self._loop.run_until_complete(self._begin())

    async def _begin(self) -> None:
        config = SocketsAdapter.Config(port=0, max_requests_per_s=10**9)
        self._adapter = SocketsAdapter(config, self._context)
        self._connect()

    def _connect(self) -> None:
        self._peer = Loopback(Connection(self._adapter.service, self._adapter.config, self._adapter.peers))

    async def _once(self) -> None:
        dice = self._dice
        self._number += 1
        message = dice.tree({key: value for key, value in dice.one(MESSAGES).items() if key != "id"})
        if isinstance(message, dict):
            message["id"] = dice.one((self._number, f"n{self._number}"))
        self._peer.feed(json.dumps(message).encode() + b"\n" if self._is_json else packed(message))
        replies: list[dict[str, Any]] = []
        for turn in range(_PATIENCE):
            await asyncio.sleep(0 if turn < 4 else 0.001)  # a peer that used up its turn rests
            replies += self._replies(self._peer.take())
            if turn >= 2 and replies:
                break
        wanted = message["id"] if isinstance(message, dict) else None
        assert [reply["id"] for reply in replies] == [wanted], (message, replies)
        assert ("result" in replies[0]) != ("error" in replies[0]), replies
        if self._peer.eof_written or self._peer.is_closing():
            assert "error" in replies[0], (message, replies)
            self._peer.die()
            await asyncio.sleep(0)
            self._connect()

    def _replies(self, data: bytes) -> list[dict[str, Any]]:
        found = []
        if self._is_json:
            found = [json.loads(line) for line in data.splitlines()]
        else:
            while data:
                (length,) = struct.unpack_from(">I", data)
                found.append(msgpack.unpackb(data[4 : 4 + length]))
                data = data[4 + length :]
        return [message for message in found if "id" in message]


class DeviceLines(Target):
    """Commands to a Water Linked A50: each line is answered once, with or without success; the next command is obeyed."""

    _COMMANDS = (
        {"command": "get_config"}, {"command": "reset_dead_reckoning"}, {"command": "trigger_ping", "parameters": None},
        {"command": "set_config", "parameters": {"mounting_rotation_offset": 20.5, "dark_mode_enabled": True}},
        {"command": "set_config", "parameters": {"acoustic_enabled": False, "range_mode": "=3", "speed_of_sound": 1480}},
    )  # fmt: skip

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        port = Port(
            "rov/dvl", "sensor", "dvl", tuple(Field(name, "1", "x") for name in water_linked_a50.FIELDS), "DVL.", 8.0, message="Dvl"
        )  # fmt: skip
        self._context = FakeContext(ports={port.path: port}, services={})
        self._device = water_linked_a50.WaterLinkedA50Table(sensor="rov/dvl").build(self._context)

    def once(self) -> None:
        dice = self._dice
        body = json.dumps(dice.tree(dice.one(self._COMMANDS))).encode()
        body = dice.one((body, dice.damaged(body))).replace(b"\n", b"")
        data = body + dice.one((b"\n", b"\r\n")) + b'{"command":"get_config"}\n'
        lines = read_all(self._device.reader(), dice.pieces(data), None)  # type: ignore[arg-type]  # reads only
        assert lines[-1] == b'{"command":"get_config"}', data
        assert len(lines) == (2 if body.strip() else 1), data
        for line in lines:
            replies: list[bytes] = []
            if isinstance(line, devices.Garbage):
                continue
            self._device.take(line, replies.append)
            assert len(replies) == 1, data
            answer = json.loads(replies[0])
            assert answer["success"] is (answer["error_message"] == ""), data
        config = answer["result"]
        assert 1000 <= config["speed_of_sound"] <= 2000, data
        assert 0 <= config["mounting_rotation_offset"] <= 360, data


class DeviceMessages(InLoop):
    """Messages to devices of binary and text protocols, changed before they get their check sums or after: no exception, settings that the device
    may have, and a new peer is answered as ever."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._context = devices_rig.make_context()
        table: Any = {"tcp_port": 0}
        beacons = {"pole": seatrac.SeaTracBeacon(id=1)}
        acoustic: Any = {"usbl": "rov/usbl", "attitude": "rov/attitude", "modem": "rov/modem"}
        inertial = {"imu": "rov/imu", "attitude": "rov/attitude", "gps": "rov/gps", "model": "VN-200"}
        self._devices: dict[str, Any] = {
            "ping360": ping360.Ping360Table(sensor="rov/sonar", **table).build(self._context),
            "vectornav": vectornav.VectorNavTable(**inertial, **table).build(self._context),
            "seatrac": seatrac.SeaTracTable(**acoustic, beacons=beacons, **table).build(self._context),
            "xsens": xsens.XsensTable(imu="rov/imu", attitude="rov/attitude", **table).build(self._context),
            "oculus": oculus.OculusTable(sonar="rov/multibeam", **table).build(self._context),
        }  # fmt: skip
        level = (1.0, 0.0, 0.0, 0.0)
        picture = (
            Buffer(dtype="uint8", shape=(2, 2), data=b"abcd"),
            2.0,
            0.5,
            Buffer(dtype="float32", shape=(2,), data=bytes(8)),
        )
        self._samples = [
            devices_rig.sample(devices_rig.ATTITUDE, (level, 0.0)),
            devices_rig.sample(devices_rig.GPS, (1.0, 0.2, 3.0, (1.0, 2.0, 3.0), 9, 3)),
            devices_rig.sample(devices_rig.IMU, ((0.0, 0.0, -9.8), (0.1, 0.2, 0.3), 12.5)),
            devices_rig.sample(devices_rig.USBL, ("pole", 15.0, 0.0, 0.0, (15.0, 0.0, 0.0), 0.02)),
            devices_rig.sample(devices_rig.SONAR, (0.0, 2.0, -12.0, (1,) * 8)),
            devices_rig.sample(devices_rig.MULTIBEAM, picture),
        ]
        self._see()

    def _see(self) -> None:
        for sample in self._samples:
            for device in self._devices.values():
                if sample.port in device.subscriptions:
                    device.see(sample)

    async def _once(self) -> None:
        name = self._dice.one(tuple(self._devices))
        device = self._devices[name]
        data: bytes = getattr(self, f"_{name}")()
        if not self._dice.below(3):
            data = self._dice.damaged(data)
        replies: list[bytes] = []
        for event in read_all(device.reader(), self._dice.pieces(data), None):  # type: ignore[arg-type]  # reads only
            if not isinstance(event, devices.Garbage):
                device.take(event, replies.append)
        self._see()
        await asyncio.sleep(0)
        self._check(name, device, data)

    def _check(self, name: str, device: Any, data: bytes) -> None:
        probe = {
            "ping360": ping_protocol.encode(ping_protocol.Frame(5)),
            "vectornav": vectornav_messages.line("VNRRG", "1"),
        }
        probe["xsens"] = xsens.encode(xsens.XbusMessage(0))
        probe["seatrac"] = seatrac_messages.encode(seatrac_messages.SeaTracMessage(1), b"#")
        replies, bad = devices_rig.ask(device, probe.get(name, b""))
        assert bad == [], data
        assert len(replies) == (0 if name == "oculus" else 1), data
        if name == "ping360":
            assert device.settings.angle < 400, data
            assert 200 <= device.settings.number_of_samples <= 1200, data
        elif name == "vectornav":
            assert device.settings.async_hz <= 200, data
        elif name == "xsens":
            assert all(rate <= 2000 or rate == 0xFFFF for _, rate in device.items), data
        elif name == "oculus":
            assert device.fire.mode in (1, 2), data
            assert 0.0 < device.fire.reach <= 1000.0, data

    def _ping360(self) -> bytes:
        dice = self._dice
        numbers = (1, 2, 100, 32, 444, 740, 800)
        fields = [dice.one((n, dice.below(1 << 16))) for n in numbers[2:]]
        body = bytes((1, dice.below(4))) + struct.pack("<5H", *fields) + bytes((dice.below(2), 0))
        scan = (
            bytes((1, dice.below(4)))
            + struct.pack("<6H", *fields, dice.below(500))
            + bytes((dice.below(12), dice.below(120)))
        )
        payload = dice.one((body, scan, dice.bytes(20), b""))
        number = dice.one((2601, 2601, 2602, 2602, 2600, 2903, 2000, 100, 6, 2300, dice.below(1 << 16)))
        return ping_protocol.encode(ping_protocol.Frame(number, payload))

    def _vectornav(self) -> bytes:
        dice = self._dice
        values = (
            "75",
            "6",
            "7",
            "8",
            "1",
            "0",
            "2",
            "14",
            "40",
            "80",
            "800",
            "01",
            "FF",
            "0108",
            "ffff",
            "-1",
            "",
            "x",
            "1e9",
            "\u0661",
            "9" * 30,
        )
        ascii_values = [value for value in values if value.isascii()]
        verb = dice.one(("VNWRG", "VNWRG", "VNRRG", "VNASY", "VNBOM", "VNWNV", "VNRST", "VNRFS", "VNTAR"))
        return vectornav_messages.line(verb, *(dice.one(ascii_values) for _ in range(dice.below(8))))

    def _xsens(self) -> bytes:
        dice = self._dice
        numbers, rates = (0x2010, 0x4022, 0x1060, 0x5042, dice.below(1 << 16)), (0, 100, 0xFFFF, dice.below(3000))
        items = [struct.pack(">HH", dice.one(numbers), dice.one(rates)) for _ in range(dice.below(36))]
        number = dice.one((0xC0, 0xC0, 0x30, 0x10, 0x40, 0x00, dice.below(256)))
        return xsens.encode(xsens.XbusMessage(number, dice.one((b"".join(items), dice.bytes(300)))))

    def _seatrac(self) -> bytes:
        dice = self._dice
        number = dice.one((0x01, 0x02, 0x03, 0x10, 0x11, 0x12, 0x3A, 0x40, 0x40, 0x50, 0x60, 0x60, dice.below(256)))
        payload = dice.one((b"\x01\x04", b"\x01\x0f\x00", b"\x02\x04", b"\x02\x02\x03abc", b"", dice.bytes(8)))
        return seatrac_messages.encode(seatrac_messages.SeaTracMessage(number, payload), b"#")

    def _oculus(self) -> bytes:
        dice = self._dice
        payload = oculus.Fire(2, 0, extended=dice.one(((), (0,) * 9))).payload()
        number = dice.one((0x15, 0x15, 0x15, 0x55, 0xFF, dice.below(256)))
        at = dice.below(len(payload) - 8)
        odd = struct.pack("<d", dice.one((0.0, -1.0, 1e308, math.nan, math.inf, 12.5)))
        changed = dice.one(
            (payload, payload[:at] + odd + payload[at + 8 :], bytes((dice.below(4), dice.below(8))) + payload[2:])
        )
        return oculus.encode(oculus.OculusMessage(number, changed, dice.below(3)))


class Rtsp(Target):
    """A client of video: pieces of any size say the same, each request has one answer of plain lines, and nothing goes to another address."""

    _REQUESTS = (
        b"OPTIONS * RTSP/1.0\r\nCSeq: 1\r\n\r\n",
        b"DESCRIBE rtsp://h:8554/front RTSP/1.0\r\nCSeq: 2\r\nAccept: application/sdp\r\n\r\n",
        b"SETUP rtsp://h/front/video RTSP/1.0\r\nCSeq: 3\r\nTransport: RTP/AVP;unicast;client_port=5000-5001\r\n\r\n",
        b"SETUP rtsp://h/front RTSP/1.0\r\nCSeq: 3\r\nTransport: RTP/AVP/TCP;interleaved=0-1;destination=10.0.0.1\r\n\r\n",
        b"SETUP rtsp://h/front RTSP/1.0\r\nCSeq: 3\r\nTransport: RTP/AVP;client_port=53-54,RTP/AVP;multicast,RTP/AVP/TCP\r\n\r\n",
        b"PLAY rtsp://h/front RTSP/1.0\r\nCSeq: 4\r\nSession: abc1\r\nRange: npt=0-\r\n\r\n",
        b"GET_PARAMETER rtsp://h/front RTSP/1.0\nCSeq: 5\nContent-Length: 4\n\nabcd",
        b"TEARDOWN rtsp://h/front RTSP/1.0\r\nCSeq: 6\r\n\r\n",
        b"$\x01\x00\x08\x81\xc9\x00\x01abcd",
    )

    class _Front:
        name = "front"

        def description(self) -> list[str]:
            return ["m=video 0 RTP/AVP 96"]

    def interleave(self, channel: int) -> None:
        assert 0 <= channel < 255  # reports go on the next one

    def open_udp(self, pair: tuple[int, int]) -> tuple[int, int] | None:
        assert all(1024 <= port <= 65535 for port in pair)
        return 6000, 6001

    def play(self, stream: str) -> None:
        assert stream == "front"

    def pause(self) -> None:
        pass

    def once(self) -> None:
        dice = self._dice
        parts = [dice.one(self._REQUESTS) for _ in range(4)]
        data = b"".join(dice.damaged(part) if dice.below(2) else part for part in parts)
        events = read_all(rtsp.Reader(), dice.pieces(data), None)
        assert events == read_all(rtsp.Reader(), [data], None), data
        assert all(not isinstance(event, rtsp.Malformed) for event in events[:-1]), data
        client = session.Session("abc1", {"front": self._Front()}, self, "127.0.0.1", 10.0, True)
        for event in events:
            if isinstance(event, rtsp.Request):
                said = client.answer(event)
                head, _, body = said.partition(b"\r\n\r\n")
                assert re.match(rb"RTSP/1\.0 [1-5][0-9][0-9] ", head), data
                assert all(32 <= byte < 127 for byte in head.replace(b"\r\n", b"")), data
                length = re.search(rb"\r\nContent-Length: ([0-9]+)", head)
                assert len(body) == (int(length[1]) if length else 0), data
                assert len(said) <= 2 * rtsp.HEAD_LIMIT, data


class CameraCommands(Target):
    """Datagrams of a ground station to a camera: whatever comes, what is said is MAVLink, and no more than a command asks for."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._mav = video_camera.mavlink.MAVLink(None, 255, 190)
        self._camera = video_camera.Camera(1, 100)
        self._facts = video_camera.Facts("front", "rov/camera", "5600", True, True, True, (640, 480), 25.0, 1_000_000)

    def once(self) -> None:
        dice = self._dice
        number, first = (
            dice.one((512, 521, 2504, 2505, 2502, 400)),
            dice.one((259.0, 269.0, 270.0, 1.0, math.nan, math.inf, -1e38)),
        )
        message = self._mav.command_long_encode(
            dice.below(3), dice.one((0, 1, 100)), number, 0, first, float(dice.below(3)), 0, 0, 0, 0, 0
        )
        data = bytes(message.pack(self._mav))
        data = dice.one((data, dice.damaged(data), data * 3, dice.bytes(600)))
        decoder = video_camera.Decoder()
        for command in decoder.commands(data):
            said = self._camera.answer(command, self._facts, dice.below(1 << 40))
            assert len(said) <= 2, data
            for frame in said:
                assert self._mav.decode(bytearray(frame)).get_srcComponent() == 100, data


class ModelFiles(Target):
    """Model files: what is checked is read or refused, whatever it says of where its numbers lie, and what is read can be drawn."""

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        corners = struct.pack("<12f", -1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0) + struct.pack(
            "<8f", 0, 1, 1, 1, 1, 0, 0, 0
        )
        self._binary = corners + struct.pack("<6H", 0, 1, 2, 0, 2, 3) + b"no picture"
        primitive = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}
        texture = {"baseColorFactor": [1.0, 0.5, 0.25, 1.0], "baseColorTexture": {"index": 0}}
        self._told: Any = {
            "nodes": [{"mesh": 0, "translation": [0.0, 3.0, 0.0], "rotation": [0.0, 0.0, 0.0, 1.0]}, {"children": [0]}],
            "meshes": [{"primitives": [primitive]}],
            "materials": [{"pbrMetallicRoughness": texture}],
            "accessors": [
                {"bufferView": 0, "byteOffset": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
                {"bufferView": 1, "byteOffset": 0, "componentType": 5126, "count": 4, "type": "VEC2"},
                {"bufferView": 2, "byteOffset": 0, "componentType": 5123, "count": 6, "type": "SCALAR"},
            ],
            "bufferViews": [
                {"byteOffset": 0, "byteLength": 48, "byteStride": 12},
                {"byteOffset": 48, "byteLength": 32, "byteStride": 8},
                {"byteOffset": 80, "byteLength": 12, "byteStride": 2},
                {"byteOffset": 92, "byteLength": 10},
            ],
            "textures": [{"source": 0}],
            "images": [{"bufferView": 3}],
            "buffers": [{"byteLength": len(self._binary)}],
        }

    def once(self) -> None:
        dice = self._dice
        told = dice.tree(self._told)
        if dice.below(2) and isinstance(told, dict):
            where = dice.one(("bufferViews", "accessors"))
            table = dict(dice.one(self._told[where]))
            key = dice.one(("byteOffset", "byteStride", "count", "componentType"))
            number = dice.one((0, 1, 2, 4, 36, 47, 252, 5121, 5125, -1, -12, -(1 << 20), 1 << 20, -(1 << 62), 1 << 63))
            told = {**told, where: [dice.one((table | {key: number}, one)) for one in self._told[where]]}
        text = json.dumps(told, allow_nan=False) if _is_plain(told) else "{}"
        binary = dice.damaged(self._binary) if dice.below(4) == 0 else self._binary
        parts = struct.pack("<I4s", len(text), b"JSON") + text.encode()
        parts += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        data = struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts
        with contextlib.suppress(BadSolid):
            check_glb(data)
            with contextlib.suppress(BadGltf):
                faces = read_glb(data).faces
                for name in ("corners", "normals", "uv", "colour"):
                    assert math.isfinite(float(abs(faces[name]).max(initial=0.0))), data


def _is_plain(value: Any) -> bool:
    try:
        json.dumps(value, allow_nan=False)
    except ValueError:
        return False
    return True


TARGETS: Mapping[str, Callable[[Dice], Target]] = {
    "json": Json,
    "msgpack": Msgpack,
    "websocket": WebSocket,
    "mavlink": Mavlink,
    "mavlink_json": MavlinkJson,
    "moos_packets": MoosPackets,
    "moos_lines": MoosLines,
    "morse_lines": MorseLines,
    "tcpros": Tcpros,
    "yarp": Yarp,
    "player": Player,
    "devices": DeviceLines,
    "device_messages": DeviceMessages,
    "rtsp": Rtsp,
    "camera": CameraCommands,
    "model_files": ModelFiles,
    "ardupilot": ArdupilotFrames,
    "px4": Px4,
    "zenoh": Zenoh,
    "http": Http,
    "replies_json": lambda dice: Replies(dice, True),
    "replies_msgpack": lambda dice: Replies(dice, False),
}
