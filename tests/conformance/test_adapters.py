"""Every installed adapter passes the conformance suite; so does one that is nothing but a folder and an entry point; faulty ones do not.

Also of uwserver.testing.adapter_kit.
"""

from __future__ import annotations

import asyncio
import importlib
import io
import json
import logging
import os
import re
import socket
import struct
import sys
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from kernel_buffers import shorten_suite
from uwserver_adapters.devices.water_linked_a50 import WaterLinkedA50Table
from uwserver_adapters.moos import wire as moos
from uwserver_adapters.moos.config import CommunityTable
from uwserver_adapters.player import wire as player
from uwserver_adapters.ros1 import wire as tcpros
from uwserver_adapters.yarp import wire as yarp
from websockets.frames import Frame, Opcode

from uwserver.adapter import AdapterNotFound, AdapterStats, adapter_entries, installed_adapters, load_adapter
from uwserver.logs import LineFormatter
from uwserver.ports import Argument, Field, Layout, Port, Service
from uwserver.testing import FakeContext, Requests, TcpPeer, check_adapter
from uwserver.testing.adapter_kit import AdapterKit, Connect, running, send
from uwserver.testing.adapters import CHECKS, PASSED
from uwserver.testing.fake_context import PORTS, SERVICES


async def _zenoh_transport(context: FakeContext) -> TcpPeer:
    """A connection to the endpoint at which the session listens, of somebody who does not speak zenoh."""
    return await TcpPeer.connect(
        replace(context, stats=AdapterStats(address=context.stats.address.removeprefix("tcp/")))
    )


async def _mavlink_station(context: FakeContext) -> TcpPeer:
    """A ground station on the link that listens; samples come unasked."""
    return await TcpPeer.connect(
        replace(context, stats=AdapterStats(address=context.stats.address.removeprefix("tcpin:")))
    )


async def _web_page(context: FakeContext) -> TcpPeer:
    """A page, after its handshake."""
    address = context.stats.address.removeprefix("http://").rstrip("/")
    peer = await TcpPeer.connect(replace(context, stats=AdapterStats(address=address)))
    await peer.send(
        b"GET /live HTTP/1.1\r\nHost: %s\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n" % address.encode()
    )
    assert (await peer.reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101 ")
    return peer


async def _morse_stream(context: FakeContext) -> TcpPeer:
    """A listener at the stream of the IMU."""
    port = context.stats.details["streams"]["rov.imu"]
    return await TcpPeer.connect(replace(context, stats=AdapterStats(address=f"127.0.0.1:{port}")))


async def _rosbridge_client(context: FakeContext) -> TcpPeer:
    """A client of rosbridge, after its handshake."""
    address = context.stats.address.removeprefix("ws://")
    peer = await TcpPeer.connect(replace(context, stats=AdapterStats(address=address)))
    await peer.send(
        b"GET / HTTP/1.1\r\nHost: %s\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n" % address.encode()
    )
    assert (await peer.reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101 ")
    return peer


async def _rtsp_client(context: FakeContext) -> TcpPeer:
    """A player, before it has said anything."""
    address = context.stats.address.removeprefix("rtsp://").rstrip("/")
    return await TcpPeer.connect(replace(context, stats=AdapterStats(address=address)))


async def _ros1(context: FakeContext) -> TcpPeer:
    """A subscriber or service client of TCPROS."""
    address = str(context.stats.details["tcpros"])
    return await TcpPeer.connect(replace(context, stats=AdapterStats(address=address)))


def _yarp_port(name: str) -> Connect:
    async def connect(context: FakeContext) -> TcpPeer:
        """Somebody at a port of YARP."""
        number = context.stats.details["ports"][f"/uwserver/{name}"]  # type: ignore[index, call-overload]
        return await TcpPeer.connect(replace(context, stats=AdapterStats(address=f"127.0.0.1:{number}")))

    return connect


_YARP_HELLO = yarp.hello("fast_tcp", "/peer")
# The devices of `FakeContext`: imu 60:0, then opaque ones, of its three ports and of its services.
_PLAYER_OPEN = b"".join(
    player.encode(player.PlayerMessage(player.PLAYER, 0, player.REQ, player.DEV, player.u32(0, 0, *device) + player.u32(player.OPEN, 0, 0)))
    for device in ((player.IMU, 0), (player.OPAQUE, 0), (player.OPAQUE, 1), (player.OPAQUE, 3))
)  # fmt: skip


def _player_call(service: str) -> bytes:
    body = player.octets(b'{"service":"%s","args":{"t_s":9}}' % service.encode())
    return player.encode(player.PlayerMessage(player.OPAQUE, 3, player.REQ, 1, body))


def _yarp_call(service: str) -> bytes:
    return b"d\r\n%s (t_s 9)\r\n" % service.encode()


def _ros1_header(**fields: str) -> bytes:
    return tcpros.header({"callerid": "/peer", "md5sum": "*", "type": "*", **fields})


def _web(text: str) -> bytes:
    """A text message of a page."""
    return Frame(Opcode.TEXT, text.encode()).serialize(mask=True)


async def _foxglove_client(context: FakeContext) -> TcpPeer:
    """A client of Foxglove, after its handshake."""
    address = context.stats.address.removeprefix("ws://")
    peer = await TcpPeer.connect(replace(context, stats=AdapterStats(address=address)))
    await peer.send(
        b"GET / HTTP/1.1\r\nHost: %s\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
        % address.encode()
    )
    assert (await peer.reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101 ")
    return peer


def _foxglove_call(service: int) -> bytes:
    """A call of a service by its number, counted from one in the order of the context."""
    body = struct.pack("<BIII", 2, service, 1, 4) + b'json{"t_s":9}'
    return Frame(Opcode.BINARY, body).serialize(mask=True)


_FOXGLOVE_ALL = json.dumps({"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in range(1, 30)]})
_FOXGLOVE_RUN = _foxglove_call(1 + [service.path for service in SERVICES].index("world/run_until"))


def _warm_zenoh() -> None:
    """The first connected sessions of a process start threads and open files that stay for all later ones."""
    zenoh = pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    text = '{{{0}: {{endpoints: ["{1}"]}}, {2}: {{endpoints: []}}, scouting: {{multicast: {{enabled: false}}}}}}'
    listening = zenoh.open(zenoh.Config.from_json5(text.format("listen", endpoint, "connect")))
    connected = zenoh.open(zenoh.Config.from_json5(text.format("connect", endpoint, "listen")))
    list(connected.get("uw/nothing", timeout=5))
    connected.close()
    listening.close()


async def _moos_database(context: FakeContext) -> TcpPeer:
    """A database where the adapter looks for one; it listens until somebody has come."""
    host, _, port = context.stats.address.split(",")[0].rpartition(":")
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        listener.setblocking(False)
        listener.bind((host, int(port)))
        listener.listen()
        accepted, _ = await asyncio.get_running_loop().sock_accept(listener)
    return TcpPeer(*await asyncio.open_connection(sock=accepted, limit=4096))


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


MOOS_PORT = _free_port()
MOOS_WELCOME = moos.packet([moos.encode(moos.MoosMessage(moos.WELCOME, "", 0.0, moos.ASYNCHRONOUS.encode()))])
MOOS_HELLO = moos.HELLO + moos.packet(
    [moos.encode(moos.MoosMessage(moos.DATA, moos.ASYNCHRONOUS, data=b"peer", kind="S"))]
)
MOOS_HEAR_ALL = moos.packet([moos.encode(moos.wildcard(moos.WILDCARD_REGISTER, "peer", 0.0, "*"))])

TRUTH_POSE = Port(
    "rov/truth/pose",
    "sensor",
    "truth_pose",
    (Field("p_NB", "m", "position", "N", (3,)), Field("q_NB", "1", "attitude", "NB", (4,))),
    "Pose.",
    rate_hz=250.0,
    message="TruePose",
)
TRUTH_VELOCITY = Port(
    "rov/truth/velocity",
    "sensor",
    "truth_velocity",
    (Field("v_NB_B", "m/s", "velocity", "B", (3,)), Field("w_NB_B", "rad/s", "rate", "B", (3,))),
    "Velocity.",
    rate_hz=250.0,
    message="TrueVelocity",
)


def _with_truth() -> FakeContext:
    return FakeContext(ports={port.path: port for port in (*PORTS, TRUTH_POSE, TRUTH_VELOCITY)})


PILOT = Port("rov/autopilot/pilot", "actuator", "autopilot", (Field("u", "1", "sticks", shape=(6,)),), "Sticks.")
ARM = Service("rov/autopilot/arm", "Arm.", (Argument("force", "bool", "x", required=False, default=False),))


def _with_autopilot() -> FakeContext:
    return FakeContext(
        ports={port.path: port for port in (*PORTS, PILOT)},
        services={service.path: service for service in (*SERVICES, ARM)},
    )


CAMERA = Port(
    "rov/camera",
    "sensor",
    "camera",
    (Field("picture", "1", "a picture", type="buffer", buffer=Layout("float32", (-1, 512))),),
    "Camera.",
    rate_hz=250.0,
    message="Image",
)
MODEM = Port(
    "rov/modem",
    "sensor",
    "modem",
    (Field("payload", "1", "what came", type="bytes"), Field("sender", "1", "from whom", type="str")),
    "Modem.",
    rate_hz=250.0,
)


def _with_buffers() -> FakeContext:
    return FakeContext(ports={port.path: port for port in (*PORTS, DVL, TRUTH_POSE, TRUTH_VELOCITY, CAMERA, MODEM)})


class UdpPeer:
    """A peer of an adapter that listens on UDP."""

    def __init__(self, context: FakeContext) -> None:
        host, _, port = context.stats.address.rpartition(":")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((host, int(port)))

    @classmethod
    async def connect(cls, context: FakeContext) -> UdpPeer:
        return cls(context)

    async def send(self, data: bytes) -> None:
        if data:
            self._socket.send(data)

    async def hear(self) -> bytes:
        return await asyncio.get_running_loop().sock_recv(self._socket, 1 << 16)

    async def close(self) -> None:
        self._socket.close()


class ServoPeer(UdpPeer):
    """An autopilot, whose frames are a datagram each."""

    async def send(self, data: bytes) -> None:
        for start in range(0, len(data), len(SERVO_FRAME)):
            await super().send(data[start : start + len(SERVO_FRAME)])


class ZenohCaller:
    """A zenoh session that asks; what it sends is `key|payload|attachment`, one question a line."""

    def __init__(self, session: Any, thread: ThreadPoolExecutor) -> None:
        self._session = session
        self._loop = asyncio.get_running_loop()
        self._thread = thread
        self._heard: asyncio.Queue[bytes] = asyncio.Queue()

    @classmethod
    async def connect(cls, context: FakeContext) -> ZenohCaller:
        import zenoh

        config = zenoh.Config()
        settings = {
            "mode": '"client"', "connect/endpoints": f'["{context.stats.address}"]', "scouting/multicast/enabled": "false",
            "transport/shared_memory/enabled": "false",
        }  # fmt: skip
        for path, value in settings.items():
            config.insert_json5(path, value)
        thread = ThreadPoolExecutor(1)
        return cls(await asyncio.get_running_loop().run_in_executor(thread, zenoh.open, config), thread)

    async def send(self, data: bytes) -> None:
        await self._loop.run_in_executor(self._thread, self._ask, data)

    def _ask(self, data: bytes) -> None:
        for line in data.decode().splitlines():
            key, payload, attachment = line.split("|")
            self._session.get(
                f"uw/uwserver/{key}", self._answered, payload=payload or None, attachment=attachment or None, timeout=30
            )

    def _answered(self, reply: Any) -> None:
        said = reply.ok or reply.err
        self._loop.call_soon_threadsafe(self._heard.put_nowait, said.payload.to_bytes())

    async def hear(self) -> bytes:
        return await self._heard.get()

    async def close(self) -> None:
        if not self._session.is_closed():
            await self._loop.run_in_executor(self._thread, self._session.close)
            self._thread.shutdown()


# MAVLink 2: HEARTBEAT of autopilot 12, as PX4 begins.
PX4_HEARTBEAT = bytes.fromhex("fd09000000010100000000000000000c00000381d6")
# HIL_ACTUATOR_CONTROLS, armed, in lock-step.
PX4_CONTROLS = bytes.fromhex(
    "fd5100000001015d0000000000000001000001000000000000000000803e0000803e00000000000000000000000000000000"
    "00000000000000000000000000000000000000000000000000000000000000000000000000000000811252"
)
# A ground station's COMMAND_LONG that arms.
MAVLINK_ARM = bytes.fromhex("fd20000000ffbe4c00000000803f000000000000000000000000000000000000000000000000900101019e4e")
SERVO_FRAME = struct.pack("<HHI16H", 18458, 250, 0, *[1500] * 16)

RTSP_PLAY = (
    b"SETUP rtsp://h/rov/camera/video RTSP/1.0\r\nCSeq: 1\r\nTransport: RTP/AVP/TCP;interleaved=0-1\r\n\r\n"
    b"PLAY rtsp://h/rov/camera RTSP/1.0\r\nCSeq: 2\r\n\r\n"
)

AT_ONCE = {"scouting/delay": 1}
"""A session of zenoh that nobody is to be looked for is open at once, and not after half a second."""

# How a peer asks each adapter for samples. An adapter without a row here fails below: it has to be added.
KITS: dict[str, tuple[dict[str, Any], Connect, bytes]] = {
    "mavlink": ({"links": ("tcpin:127.0.0.1:0",)}, _mavlink_station, b""),
    "foxglove": ({"port": 0}, _foxglove_client, _web(_FOXGLOVE_ALL)),
    # Each community is one connection, and so can have one peer.
    "devices": (
        {"device": {"dvl": WaterLinkedA50Table(sensor="rov/dvl", tcp_port=0, max_clients=64)}},
        TcpPeer.connect,
        b'{"command":"get_config"}\n',
    ),
    "ardupilot_json": ({"port": 0, "truth": True, "silence_s": 1.0}, UdpPeer.connect, SERVO_FRAME),
    "moos": ({"communities": {name: CommunityTable(port=MOOS_PORT) for name in "abcd"}}, _moos_database, MOOS_WELCOME),
    "moosdb": ({"port": 0, "queue_bytes": 1 << 18}, TcpPeer.connect, MOOS_HELLO + MOOS_HEAR_ALL),
    "moos_text": ({"port": 0, "queue_bytes": 1 << 18}, TcpPeer.connect, b"SUBSCRIBE *\n"),
    "morse": ({"port": 0, "stream_port": 0, "queue_bytes": 1 << 16}, _morse_stream, b""),
    "player": ({"port": 0, "queue_bytes": 1 << 16}, TcpPeer.connect, _PLAYER_OPEN),
    "px4_hil": ({"port": 0, "truth": True}, TcpPeer.connect, PX4_HEARTBEAT),
    # Who connects to it says nothing, and the end of a session waits until such are given up.
    "ros2": (
        {"listen": ("tcp/127.0.0.1:0",), "domain": 0, "config": {**AT_ONCE, "transport/unicast/accept_timeout": 50}},
        _zenoh_transport,
        b"",
    ),
    "ros1": ({"master": "http://127.0.0.1:9", "queue_bytes": 1 << 16}, _ros1, _ros1_header(topic="/rov/imu")),
    "rosbridge": ({"port": 0}, _rosbridge_client, _web('{"op":"subscribe","topic":"/rov/imu"}')),
    "sockets": ({"port": 0}, TcpPeer.connect, b'{"method":"subscribe","params":{"pattern":"**"}}\n'),
    "video": (
        {"rtsp_port": 0, "codec": "jpeg", "queue_bytes": 1 << 16, "max_clients": 64},
        _rtsp_client,
        RTSP_PLAY,
    ),
    "web": ({"port": 0}, _web_page, _web('{"method":"subscribe","params":{"pattern":"**"}}')),
    "yarp": (
        {"name_server": "127.0.0.1:9", "queue_bytes": 1 << 16},
        _yarp_port("rov/imu:o"),
        _YARP_HELLO + yarp.message(False, "r"),
    ),
    "zenoh": (
        {"listen": ("tcp/127.0.0.1:0",), "scouting": False, "config": {"scouting/delay": 1}},
        _zenoh_transport,
        b"",
    ),
}


def _moos_call(text: str, name: str = "peer") -> bytes:
    return moos.packet([moos.encode(moos.notify("UWSERVER_CALL", text, 1e12, name))])


def _moos(frame: Callable[[str], bytes]) -> Requests:
    """MOOS knows no cancel, and nobody's leaving ends a call: each has a time-out."""
    call = '{"id":1,"service":"%s","args":{"t_s":9},"timeout_s":%g}'
    return Requests(
        frame(call % ("world/run_until", 60)), brief=frame(call % ("world/run_until", 0.5)),
        many=frame(call % ("world/run_until", 61)), misspelt=frame(call % ("world/run_untill", 60)),
    )  # fmt: skip


# How a peer asks, in each protocol.
REQUESTS = {
    "mavlink": Requests(MAVLINK_ARM, many=MAVLINK_ARM, service=ARM.path, outlives=True),
    "ardupilot_json": Requests(many=SERVO_FRAME, speak=ServoPeer.connect),
    "px4_hil": Requests(many=PX4_CONTROLS),
    "foxglove": Requests(_FOXGLOVE_RUN, many=_FOXGLOVE_RUN),
    "devices": Requests(
        b'{"command":"set_config","parameters":{"range_mode":"=2"}}\n',
        many=b'{"command":"set_config","parameters":{"range_mode":"=1"}}\n',
        service="rov/dvl/set",
        outlives=True,
    ),
    "sockets": Requests(
        b'{"id":1,"method":"call","params":{"service":"world/run_until","args":{"t_s":9}}}\n',
        cancel=b'{"id":2,"method":"cancel","params":{"id":1}}\n',
        many=b'{"method":"call","params":{"service":"world/run_until","args":{"t_s":9}}}\n',
        misspelt=b'{"id":3,"method":"call","params":{"service":"world/run_untill","args":{"t_s":9}}}\n',
    ),
    "ros2": Requests(),  # its own tests call services: a stranger on this port has no session
    "rosbridge": Requests(
        _web('{"op":"call_service","id":"1","service":"/world/run_until","args":{"t_s":9}}'),
        many=_web('{"op":"call_service","service":"/world/run_until","args":{"t_s":9}}'),
        misspelt=_web('{"op":"call_service","id":"3","service":"/world/run_untill","args":{"t_s":9}}'),
    ),
    "video": Requests(many=b"GET_PARAMETER rtsp://h/ RTSP/1.0\r\nCSeq: 1\r\n\r\n"),
    "web": Requests(
        _web('{"id":1,"method":"call","params":{"service":"world/run_until","args":{"t_s":9}}}'),
        cancel=_web('{"id":2,"method":"cancel","params":{"id":1}}'),
        many=_web('{"method":"call","params":{"service":"world/run_until","args":{"t_s":9}}}'),
        misspelt=_web('{"id":3,"method":"call","params":{"service":"world/run_untill","args":{"t_s":9}}}'),
    ),
    "zenoh": Requests(
        b'world/run_until|{"t_s":9}|{"client":"c1","id":1}\n',
        cancel=b'@cancel||{"client":"c1","id":1}\n',
        brief=b'world/run_until?timeout_s=0.5|{"t_s":9}|\n',
        many=b'world/run_until|{"t_s":9}|\n',
        misspelt=b'world/run_untill|{"t_s":9}|\n',
        speak=ZenohCaller.connect,
    ),
    "ros1": Requests(
        _ros1_header(service="/world/run_until", persistent="1") + tcpros.block(struct.pack("<d", 9.0)),
        many=tcpros.block(struct.pack("<d", 9.0)),
        misspelt=_ros1_header(service="/world/run_untill"),
        speak=_ros1,
    ),
    "player": Requests(
        _player_call("world/run_until"), many=_player_call("world/run_until"), misspelt=_player_call("world/run_untill")
    ),
    "yarp": Requests(
        b"CONNECT /peer\r\n" + _yarp_call("run_until"),
        many=_yarp_call("run_until"),
        misspelt=b"CONNECT /peer\r\n" + _yarp_call("run_untill"),
        speak=_yarp_port("world/rpc:i"),
    ),
    "moos": _moos(_moos_call),
    "moosdb": _moos(_moos_call),
    "moos_text": _moos(lambda text: b"CALL %s\n" % text.encode()),
    "morse": Requests(
        b"1 world run_until [9]\n",
        cancel=b"1 cancel\n",
        many=b"2 world run_until [9]\n",
        misspelt=b"3 world run_untill [9]\n",
        speak=TcpPeer.connect,
    ),
}
# What a protocol cannot say; all other checks run.
_STORM, _LEAVES, _CANCEL, _TIME_OUT, _NAMES = (
    "check_connection_storm",
    "check_leaves_in_the_middle_of_a_call",
    "check_cancel",
    "check_time_out",
    "check_did_you_mean",
)
UNSAID = {
    "mavlink": {_CANCEL, _TIME_OUT, _NAMES},
    "ardupilot_json": {_STORM, _LEAVES, _CANCEL, _TIME_OUT, _NAMES},
    "px4_hil": {_LEAVES, _CANCEL, _TIME_OUT, _NAMES},
    "foxglove": {_CANCEL, _TIME_OUT, _NAMES},  # services go by numbers, and nobody can take a call back
    "ros2": {_LEAVES, _CANCEL, _TIME_OUT, _NAMES, "check_flood"},
    "rosbridge": {_CANCEL, _TIME_OUT},
    "devices": {_CANCEL, _TIME_OUT, _NAMES},
    "sockets": {_TIME_OUT},
    "video": {_LEAVES, _CANCEL, _TIME_OUT, _NAMES},  # nothing of the world can be asked
    "web": {_TIME_OUT},
    "player": {_CANCEL, _TIME_OUT},
    "ros1": {_CANCEL, _TIME_OUT},
    "yarp": {_CANCEL, _TIME_OUT},
    "moos": {_CANCEL},
    "moosdb": {_CANCEL},
    "moos_text": {_CANCEL},
    "morse": {_TIME_OUT},
}
DVL = Port(
    "rov/dvl",
    "sensor",
    "dvl",
    (
        Field("v_S", "m/s", "velocity", "S", (3,)), Field("altitude", "m", "altitude"), Field("figure_of_merit", "m/s", "accuracy"),
        Field("covariance_S", "m^2/s^2", "covariance", "S", (3, 3)), Field("beam_velocities", "m/s", "beams", shape=(4,)),
        Field("beam_ranges", "m", "beams", shape=(4,)), Field("beam_locks", "1", "beams", shape=(4,), type="bool"),
    ),
    "DVL.",
    rate_hz=250.0, message="Dvl",
)  # fmt: skip
SET_DVL = Service("rov/dvl/set", "Change.", (Argument("range_mode", "int", "mode", required=False),))


def _with_dvl() -> FakeContext:
    return FakeContext(
        ports={port.path: port for port in (*PORTS, DVL)},
        services={service.path: service for service in (*SERVICES, SET_DVL)},
    )


IMAGE = Field("image", "1", "picture", type="buffer", buffer=Layout("uint8", (-1, -1, 3)))
CAMERA = Port("rov/camera", "sensor", "camera", (IMAGE,), "Camera.", rate_hz=25.0, message="Image")


def _with_camera() -> FakeContext:
    return FakeContext(ports={port.path: port for port in (*PORTS, CAMERA)})


CONTEXTS = {
    "video": _with_camera,
    "devices": _with_dvl,
    "ardupilot_json": _with_truth,
    "px4_hil": _with_truth,
    "mavlink": _with_autopilot,
}

THIRD_PARTY = '''
"""Text lines of samples on TCP: a whole adapter of somebody else."""

import asyncio

from uwserver.adapter import AdapterTable


class SpyConfig(AdapterTable, tag="spy", kw_only=True, frozen=True):
    port: int = 0


class Spy:
    Config = SpyConfig

    def __init__(self, config, context):
        self.config, self.context, self.writers = config, context, set()

    async def run(self, ready):
        stats = self.context.stats
        server = await asyncio.get_running_loop().create_server(lambda: Link(self), "127.0.0.1", self.config.port)
        detach = self.context.attach(self)
        try:
            stats.address = "127.0.0.1:%d" % server.sockets[0].getsockname()[1]
            stats.state = "running"
            ready.set()
            await asyncio.Event().wait()
        finally:
            detach()
            server.close()
            for link in list(self.writers):
                link.transport.abort()
            await asyncio.sleep(0)
            stats.state = "stopped"

    def put_samples(self, samples):
        for sample in samples:
            for link in self.writers:
                if link.ready:
                    link.transport.write(b"%s %d\\n" % (sample.port.encode(), sample.seq))
                else:
                    self.context.stats.dropped += 1

    def put_event(self, event):
        pass


class Link(asyncio.Protocol):
    def __init__(self, adapter):
        self.adapter, self.ready = adapter, True

    def connection_made(self, transport):
        self.transport = transport
        self.adapter.writers.add(self)
        self.adapter.context.stats.peers += 1

    def connection_lost(self, error):
        self.adapter.writers.discard(self)
        self.adapter.context.stats.peers -= 1

    def pause_writing(self):
        self.ready = False

    def resume_writing(self):
        self.ready = True
'''
SWALLOWS = """\
            while True:
                try:
                    await asyncio.sleep(30)
                except asyncio.CancelledError:
                    await asyncio.sleep(1.5)
                    raise
"""
# One fault each: what it replaces in the adapter above, and what the suite must say.
FAULTS = {
    "swallows the cancellation": (
        "            await asyncio.Event().wait()\n",
        SWALLOWS,
        "has not ended 1 s after it was cancelled",
    ),
    "stays attached": ("            detach()\n", "", "still attached"),
    "leaves its socket": ("            server.close()\n", "            self.config.__class__.kept = server\n", "leaves behind: file"),
    "leaves a task": ("            ready.set()\n", "            ready.set(); asyncio.create_task(asyncio.sleep(30))\n", "leaves behind: task"),
    "leaves a thread": (
        "            ready.set()\n",
        "            ready.set(); import threading; threading.Thread(target=threading.Event().wait, args=(9,)).start()\n",
        "leaves behind: thread",
    ),
    "dies of an event": ("        pass\n", "        raise RuntimeError(event.event)\n", "paused"),
    "never ready": ("            ready.set()\n", "", "ready was not set"),
    "ends by itself": ("            await asyncio.Event().wait()\n", "", "serves until it is cancelled"),
    "does not say where": ('            stats.address = "127.0.0.1:%d" % server.sockets[0].getsockname()[1]\n', "", "stats.address is empty"),
    "does not say that it runs": ('            stats.state = "running"\n', "", 'it must be "running"'),
    "does not say that it ended": ('            stats.state = "stopped"\n', "", 'it must be "stopped"'),
    "does not count its peers back": ("        self.adapter.context.stats.peers -= 1\n", "        pass\n", "does not return to 0"),
}  # fmt: skip


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten_suite(monkeypatch)
    monkeypatch.setattr("uwserver_adapters.moos.bridge.client.RETRY_S", 0.02)
    monkeypatch.setattr("uwserver_adapters.zenoh_bus.adapter.TAKEN_S", 0.1)
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)


BRIEFLY = {
    "never ready": "START_S",
    "swallows the cancellation": "CANCEL_S",
    "does not count its peers back": "SETTLE_S",
}
"""Faults that are what does not happen in a time, and what that is called."""


def run(check: Callable[[], Awaitable[Any]]) -> Any:
    async def bounded() -> Any:
        return await asyncio.wait_for(check(), 180)

    return asyncio.run(bounded())


@pytest.mark.parametrize("kind", sorted(adapter_entries()))
def test_installed_adapters(kind: str) -> None:
    assert kind in KITS, f'adapter "{kind}" has no row in KITS'
    table, connect, greeting = KITS[kind]
    adapter = load_adapter(kind)
    if kind in ("ros2", "zenoh"):
        _warm_zenoh()
    if kind == "mavlink":
        pytest.importorskip("pymavlink", reason="pymavlink is not installed")

    def checked() -> Any:
        return run(
            lambda: check_adapter(
                adapter,
                adapter.Config(**table),
                connect=connect,
                greeting=greeting,
                make_context=CONTEXTS.get(kind, FakeContext),
                requests=REQUESTS[kind],
            )
        )

    try:
        outcomes = checked()
    except AssertionError as error:
        # Threads of zenoh accept and close sockets when a busy machine lets them. What an adapter of ours leaves behind it leaves each time.
        if kind not in ("ros2", "zenoh") or "leaves behind: file" not in str(error):
            raise
        outcomes = checked()
    unsaid = UNSAID.get(kind, set())
    assert {name for name, outcome in outcomes.items() if outcome.startswith("does not apply: the protocol ")} == unsaid
    assert {name for name, outcome in outcomes.items() if outcome == PASSED} == set(CHECKS) - unsaid


DDS_DOMAIN = 190 + os.getpid() % 40


class DdsStranger:
    """Somebody who sends what is no RTPS to the ports of discovery, and hears nothing."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    @classmethod
    async def connect(cls, context: FakeContext) -> DdsStranger:
        return cls()

    async def send(self, data: bytes) -> None:
        for port in (10, 11):  # of the first participant: of discovery, and of samples
            self._socket.sendto(data[:1400], ("127.0.0.1", 7400 + 250 * DDS_DOMAIN + port))

    async def hear(self) -> bytes:
        await asyncio.sleep(3600.0)
        return b""

    async def close(self) -> None:
        self._socket.close()


def test_ros2_on_dds() -> None:
    """The other transport of `ros2`, whose sockets are CycloneDDS' own; its peers are in tests/unit/adapters/ros2."""
    pytest.importorskip("cyclonedds")
    adapter = load_adapter("ros2")
    table = adapter.Config(transport="dds", allow_network=True, domain=DDS_DOMAIN)
    outcomes = run(lambda: check_adapter(adapter, table, connect=DdsStranger.connect, greeting=b"RTPS"))
    assert [name for name, outcome in outcomes.items() if outcome != PASSED] == [
        _STORM, _LEAVES, _CANCEL, _TIME_OUT, "check_flood", _NAMES,
    ]  # fmt: skip


@pytest.mark.parametrize("check", ["check_strange_samples", "check_events"])
@pytest.mark.parametrize("kind", sorted(adapter_entries()))
def test_pictures_payloads_and_texts_are_no_trouble(kind: str, check: str) -> None:
    if kind == "mavlink":
        pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    table, connect, greeting = KITS[kind]
    adapter = load_adapter(kind)
    kit = AdapterKit(adapter, adapter.Config(**table), connect, greeting, _with_buffers)
    run(lambda: CHECKS[check](kit))


def test_sockets_is_installed() -> None:
    assert "sockets" in adapter_entries()


class Site:
    """A folder on sys.path, as site-packages is one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def install(self, kind: str, target: str, source: str | None = None) -> None:
        module = target.partition(":")[0]
        if source is not None:
            (self.folder / module).mkdir()
            (self.folder / module / "__init__.py").write_text(source)
        info = self.folder / f"{module}_dist-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}-dist\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[uwserver.adapters]\n{kind} = {target}\n")
        importlib.invalidate_caches()


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    yield Site(tmp_path)
    for name in set(sys.modules) - before:
        if name.startswith("spy_of_test"):
            del sys.modules[name]


def test_a_third_party_adapter_is_one_folder(site: Site) -> None:
    site.install("spy", "spy_of_test:Spy", THIRD_PARTY)
    assert installed_adapters()["spy"].__struct_config__.tag == "spy"
    adapter = load_adapter("spy")
    outcomes = run(lambda: check_adapter(adapter, adapter.Config(), connect=TcpPeer.connect))
    assert list(outcomes) == list(CHECKS)
    assert outcomes["check_flood"] == "does not apply: the protocol cannot ask again and again"
    assert sum(outcome == PASSED for outcome in outcomes.values()) == len(CHECKS) - 5


@pytest.mark.parametrize("fault", FAULTS)
def test_the_suite_sees_a_fault(site: Site, fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if fault in BRIEFLY:
        monkeypatch.setattr(f"uwserver.testing.adapter_kit.{BRIEFLY[fault]}", 1.0)
    monkeypatch.setattr(
        "uwserver.testing.adapter_kit.range", lambda _: range(10), raising=False
    )  # what is left behind it need not wait for
    right, wrong, phrase = FAULTS[fault]
    assert THIRD_PARTY.count(right) == 1
    site.install("spy", "spy_of_test:Spy", THIRD_PARTY.replace(right, wrong))
    adapter = importlib.import_module("spy_of_test").Spy
    with pytest.raises((AssertionError, RuntimeError), match=phrase):
        run(lambda: check_adapter(adapter, adapter.Config(), connect=TcpPeer.connect))
    if hasattr(adapter.Config, "kept"):
        adapter.Config.kept.close()


def test_adapters_that_cannot_be_loaded_name_their_distribution(site: Site) -> None:
    site.install("spy", "spy_of_test_nowhere:Spy")
    with pytest.raises(AdapterNotFound, match="spy_of_test_nowhere-dist cannot be imported"):
        load_adapter("spy")
    with pytest.raises(AdapterNotFound, match="no adapter"):
        load_adapter("spi")


HOSTILE = b"\x1b[2J\x07\x7f"
"""Clears a terminal, and rings."""


def _hostile_words(kind: str) -> Iterator[bytes]:
    """What a peer of this kind says, each time with one word that commands a terminal."""
    _, connect, greeting = KITS[kind]
    if connect in (_web_page, _rosbridge_client, _foxglove_client):
        for name in (b"Host", b"Origin", b"Sec-Fetch-Site", b"Authorization"):
            yield b"GET /live HTTP/1.1\r\n%s: x%sy\r\n\r\n" % (name, HOSTILE)
    requests = REQUESTS[kind]
    for said in (greeting, requests.call, requests.misspelt):
        for word in list(re.finditer(rb"[A-Za-z/_]{3,}", said))[:4]:
            middle = (word.start() + word.end()) // 2
            yield said[:middle] + HOSTILE + said[middle:]


@pytest.mark.parametrize(
    "kind", sorted(kind for kind, (_, connect, _) in KITS.items() if connect is not UdpPeer.connect)
)
def test_no_stranger_commands_the_terminal_of_the_log(kind: str) -> None:
    """The formatter is the same for all; here each adapter's own texts go through it."""
    if kind in ("ros2", "zenoh"):
        _warm_zenoh()
    table, connect, _ = KITS[kind]
    adapter = load_adapter(kind)
    kit = AdapterKit(adapter, adapter.Config(**table), connect, b"", CONTEXTS.get(kind, FakeContext), REQUESTS[kind])
    written = io.StringIO()
    output = logging.StreamHandler(written)
    output.setFormatter(LineFormatter("%(message)s"))

    async def scene() -> None:
        async with running(kit) as adapter:
            for said in _hostile_words(kind):
                peer = await adapter.connect()
                await send(peer, said)
                await asyncio.sleep(0.02)
                await peer.close()

    logging.getLogger().addHandler(output)
    try:
        run(scene)
    finally:
        logging.getLogger().removeHandler(output)
    assert all(line.isprintable() for line in written.getvalue().splitlines())
