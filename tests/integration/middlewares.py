"""Clients of the robot middlewares that a server speaks, each as small as it can be: they hear an IMU and the pose, and command thrusters.

What they hear they put back into the world's own axes (N and S), so that it can be compared with what the world made. They know their protocols by
bytes, JSON or a library of others; of ours they use the types of ROS and nothing else.
"""

from __future__ import annotations

import contextlib
import json
import math
import queue
import re
import socket
import struct
import threading
import time
import xmlrpc.client
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

from uwserver.frames import attitude_enu_flu, quat_from_rpy

PATIENCE_S = 120
IMU, POSE, THRUSTERS = "one/imu", "one/truth/pose", "one/thrusters"
Numbers = tuple[float, ...]


def swapped(p: Sequence[float]) -> Numbers:
    """North, east, down of east, north, up."""
    return (p[1], p[0], -p[2])


def flipped(v: Sequence[float]) -> Numbers:
    """Forward, right, down of forward, left, up."""
    return (v[0], -v[1], -v[2])


def moment(seconds: float) -> int:
    """A time as a key: in 0.1 ms, as stamps of UTC in s have no more than some 0.2 us."""
    return round(seconds * 1e4)


class Client:
    """One client.

    Attributes:
        told: port -> moment of the measurement -> its numbers in the world's axes: f_S and w_S, or p_NB and q_NB.
        again: whether a sample may come more than once: a player tells who comes later the newest of what it has told.
        rounds: what the protocol makes of a number.
        adapter: name of the adapter that serves it.
    """

    adapter = ""
    again = False
    rounds: Callable[[float], float] = staticmethod(lambda number: number)

    def __init__(self, epoch_s: float) -> None:
        self.told: dict[str, dict[int, Numbers]] = {IMU: {}, POSE: {}}
        self._epoch_s = epoch_s

    def hear(self, port: str, utc_s: float, *parts: Sequence[float]) -> None:
        """Keep a sample."""
        key = moment(utc_s - self._epoch_s)
        numbers = tuple(number for part in parts for number in part)
        if key in self.told[port]:
            assert self.again, f"{port} at {utc_s} came twice"
            assert self.told[port][key] == numbers
        self.told[port][key] = numbers

    def count(self) -> int:
        """Samples that came."""
        return sum(map(len, self.told.values()))

    def pump(self, timeout_s: float) -> None:
        """Take what comes."""
        raise NotImplementedError

    def command(self, u: Sequence[float]) -> None:
        """Command all thrusters."""
        raise NotImplementedError

    def close(self) -> None:
        """End it."""


def _ros_imu(message: Any) -> tuple[Numbers, Numbers]:
    f, w = message["linear_acceleration"], message["angular_velocity"]
    return flipped([f["x"], f["y"], f["z"]]), flipped([w["x"], w["y"], w["z"]])


def _ros_pose(message: Any) -> tuple[Numbers, Numbers]:
    p, q = message["pose"]["pose"]["position"], message["pose"]["pose"]["orientation"]
    return swapped([p["x"], p["y"], p["z"]]), attitude_enu_flu([q["w"], q["x"], q["y"], q["z"]])


_ROS: Mapping[str, tuple[str, str, Any]] = {
    "/one/imu": (IMU, "sensor_msgs/msg/Imu", _ros_imu),
    "/one/truth/odom": (POSE, "nav_msgs/msg/Odometry", _ros_pose),
}
_ARRAY = "std_msgs/msg/Float64MultiArray"


class Rosbridge(Client):
    """JSON over a WebSocket."""

    adapter = "rosbridge"

    def __init__(self, adapters: Mapping[str, Any], epoch_s: float) -> None:
        from websockets.sync.client import connect

        super().__init__(epoch_s)
        self._stack = contextlib.ExitStack()
        self._socket = self._stack.enter_context(connect(adapters["rosbridge"]["address"], max_size=None))
        for topic, (_, kind, _) in _ROS.items():
            self._say(op="subscribe", topic=topic, type=kind.replace("/msg", ""))
        self._say(op="call_service", service="/rosapi/get_time", id="asked")
        while json.loads(self._socket.recv(PATIENCE_S)).get("id") != "asked":
            pass

    def _say(self, **message: object) -> None:
        self._socket.send(json.dumps(message))

    def pump(self, timeout_s: float) -> None:
        with contextlib.suppress(TimeoutError):
            while True:
                said = json.loads(self._socket.recv(timeout_s))
                if said["op"] == "publish":
                    port, _, read = _ROS[said["topic"]]
                    stamp = said["msg"]["header"]["stamp"]
                    seconds = stamp.get("sec", stamp.get("secs")) + stamp.get("nanosec", stamp.get("nsecs")) * 1e-9
                    self.hear(port, seconds, *read(said["msg"]))

    def command(self, u: Sequence[float]) -> None:
        self._say(
            op="publish", topic="/one/thrusters/cmd", msg={"layout": {"dim": [], "data_offset": 0}, "data": list(u)}
        )

    def close(self) -> None:
        self._stack.close()


def _mapping(message: Any) -> Any:
    """A message of rosbags as a map."""
    fields = getattr(message, "__dataclass_fields__", None)
    return message if fields is None else {name: _mapping(getattr(message, name)) for name in fields}


class Ros2(Client):
    """rmw_zenoh's keys and CDR on a session of zenoh."""

    adapter = "ros2"

    def __init__(self, adapters: Mapping[str, Any], epoch_s: float) -> None:
        import zenoh
        from uwserver_adapters.ros.messages import Types
        from uwserver_adapters.ros.messages.types import dds_name

        super().__init__(epoch_s)
        config = zenoh.Config()
        for path, value in {
            "mode": '"client"', "connect/endpoints": f'["{adapters["ros2"]["address"]}"]', "scouting/multicast/enabled": "false",
        }.items():  # fmt: skip
            config.insert_json5(path, value)
        self._session, self._types = zenoh.open(config), Types("jazzy")
        self._key = lambda topic, kind: f"0{topic}/{dds_name(kind)}/{self._types.hash(kind)}"
        self._heard: queue.Queue[tuple[str, bytes]] = queue.Queue()
        self._held = [self._subscribed(topic) for topic in _ROS]

    def _subscribed(self, topic: str) -> Any:
        put = self._heard.put
        return self._session.declare_subscriber(
            self._key(topic, _ROS[topic][1]), lambda sample: put((topic, sample.payload.to_bytes()))
        )

    def pump(self, timeout_s: float) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                topic, data = self._heard.get(timeout=timeout_s)
                port, kind, read = _ROS[topic]
                message = _mapping(self._types.from_cdr(data, kind))
                stamp = message["header"]["stamp"]
                self.hear(port, stamp["sec"] + stamp["nanosec"] * 1e-9, *read(message))

    def command(self, u: Sequence[float]) -> None:
        import numpy as np
        import zenoh

        data = self._types.cdr(self._types.make(_ARRAY, data=np.array(u)))
        self._session.put(
            self._key("/one/thrusters/cmd", _ARRAY),
            data,
            attachment=struct.pack("<qqB16s", 1, time.time_ns(), 16, bytes(16)),
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    def close(self) -> None:
        self._session.close()


def _tcpros_header(**fields: str) -> bytes:
    lines = [f"{key}={value}".encode() for key, value in fields.items()]
    body = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    return struct.pack("<I", len(body)) + body


class Ros1(Client):
    """TCPROS, and as a publisher also XML-RPC; there is no master, which only introduces nodes to each other."""

    adapter = "ros1"

    def __init__(self, adapters: Mapping[str, Any], epoch_s: float) -> None:
        from uwserver_adapters.ros.messages import Types

        super().__init__(epoch_s)
        host, _, port = adapters["ros1"]["details"]["tcpros"].rpartition(":")
        self._api = xmlrpc.client.ServerProxy(adapters["ros1"]["address"])
        self._types = Types("noetic")
        self._streams: dict[str, socket.socket] = {}
        for topic in _ROS:
            stream = self._streams[topic] = socket.create_connection((host, int(port)), PATIENCE_S)
            stream.sendall(_tcpros_header(callerid="/story", topic=topic, md5sum="*", type="*"))
            self._block(stream)
        self._publisher: socket.socket | None = None

    @staticmethod
    def _block(stream: socket.socket) -> bytes:
        data = b""
        while len(data) < 4 or len(data) < 4 + struct.unpack("<I", data[:4])[0]:
            piece = stream.recv(4 - len(data) if len(data) < 4 else 4 + struct.unpack("<I", data[:4])[0] - len(data))
            if not piece:
                raise ConnectionError("the server ended the connection")
            data += piece
        return data[4:]

    def pump(self, timeout_s: float) -> None:
        for topic, stream in self._streams.items():
            port, kind, read = _ROS[topic]
            with contextlib.suppress(TimeoutError):
                while True:
                    stream.settimeout(timeout_s)
                    stream.recv(1, socket.MSG_PEEK)
                    stream.settimeout(PATIENCE_S)
                    message = _mapping(self._types.from_ros1(self._block(stream), kind))
                    stamp = message["header"]["stamp"]
                    self.hear(port, stamp["sec"] + stamp["nanosec"] * 1e-9, *read(message))

    def command(self, u: Sequence[float]) -> None:
        import numpy as np

        if self._publisher is None:
            self._publisher = self._publishing("/one/thrusters/cmd")
        raw = self._types.ros1(self._types.make(_ARRAY, data=np.array(u)))
        self._publisher.sendall(struct.pack("<I", len(raw)) + raw)

    def _publishing(self, topic: str) -> socket.socket:
        """Be a node that publishes a topic, until the server has connected to it."""
        with (
            socket.create_server(("127.0.0.1", 0)) as listener,
            SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as api,
        ):
            listener.settimeout(PATIENCE_S)
            place = ["TCPROS", "127.0.0.1", listener.getsockname()[1]]
            api.register_function(lambda caller, topic, protocols: [1, "", place], "requestTopic")
            asked = threading.Thread(target=api.handle_request)
            asked.start()
            self._api.publisherUpdate("/master", topic, [f"http://127.0.0.1:{api.server_address[1]}/"])
            stream, _ = listener.accept()
            asked.join()
        self._block(stream)
        kind = _ARRAY.replace("/msg", "")
        stream.sendall(_tcpros_header(callerid="/story", topic=topic, type=kind, md5sum=self._types.md5(_ARRAY)))
        return stream

    def close(self) -> None:
        self._api("close")()
        for stream in [*self._streams.values(), *([self._publisher] if self._publisher else [])]:
            stream.close()


class Lines(Client):
    """One of lines on several connections."""

    def __init__(self, epoch_s: float) -> None:
        super().__init__(epoch_s)
        self._streams: dict[str, socket.socket] = {}
        self._rest: dict[str, bytes] = {}

    def open(self, name: str, address: tuple[str, int]) -> socket.socket:
        self._streams[name] = socket.create_connection(address, PATIENCE_S)
        self._rest[name] = b""
        return self._streams[name]

    def lines(self, name: str, timeout_s: float) -> list[str]:
        stream = self._streams[name]
        stream.settimeout(timeout_s)
        with contextlib.suppress(TimeoutError):
            self._rest[name] += stream.recv(1 << 20)
        *lines, self._rest[name] = self._rest[name].split(b"\n")
        return [line.decode().strip() for line in lines]

    def close(self) -> None:
        for stream in self._streams.values():
            stream.close()


class Morse(Lines):
    """A stream of JSON lines for each component."""

    adapter = "morse"

    def __init__(self, adapters: Mapping[str, Any], epoch_s: float) -> None:
        super().__init__(epoch_s)
        streams = adapters["morse"]["details"]["streams"]
        for port, name in ((IMU, "one.imu"), (POSE, "one.pose"), (THRUSTERS, "one.thrusters")):
            self.open(port, ("127.0.0.1", streams[name]))

    def pump(self, timeout_s: float) -> None:
        for said in map(json.loads, self.lines(IMU, timeout_s)):
            self.hear(IMU, said["timestamp"], flipped(said["linear_acceleration"]), flipped(said["angular_velocity"]))
        for said in map(json.loads, self.lines(POSE, timeout_s)):
            q = said["orientation"]
            self.hear(
                POSE,
                said["timestamp"],
                swapped([said["x"], said["y"], said["z"]]),
                attitude_enu_flu([q["w"], q["x"], q["y"], q["z"]]),
            )

    def command(self, u: Sequence[float]) -> None:
        self._streams[THRUSTERS].sendall(json.dumps({"u": list(u)}).encode() + b"\n")


_GROUP = re.compile(r"\((\w+) \(([^()]*)\)\)")


class Yarp(Lines):
    """Ports of YARP on the carrier text_ack; the axes are the world's own."""

    adapter = "yarp"

    def __init__(self, adapters: Mapping[str, Any], epoch_s: float) -> None:
        super().__init__(epoch_s)
        ports = adapters["yarp"]["details"]["ports"]
        for port, name in ((IMU, "one/imu:o"), (POSE, "one/truth/pose:o"), (THRUSTERS, "one/thrusters:i")):
            stream = self.open(port, ("127.0.0.1", ports[f"/uwserver/{name}"]))
            stream.sendall(b"CONNACK /story\r\n" + (b"" if port == THRUSTERS else b"r\r\n"))
            while "<ACK>" not in (said := self.lines(port, PATIENCE_S)) and port != THRUSTERS:
                assert said

    def pump(self, timeout_s: float) -> None:
        for port, fields in ((IMU, ("f_S", "w_S")), (POSE, ("p_NB", "q_NB"))):
            lines = self.lines(port, timeout_s)
            if len(lines) % 2:  # the bottle of the last one is still to come
                self._rest[port] = lines.pop().encode() + b"\n" + self._rest[port]
            for stamp, bottle in zip(lines[::2], lines[1::2], strict=True):
                groups = {name: tuple(map(float, numbers.split())) for name, numbers in _GROUP.findall(bottle)}
                self.hear(port, float(stamp.split()[2]) + self._epoch_s, *(groups[name] for name in fields))

    def command(self, u: Sequence[float]) -> None:
        self._streams[THRUSTERS].sendall(f"D\r\n{' '.join(map(repr, u))}\r\n".encode())


class Player(Client):
    """position3d, imu, and an opaque device for the thrusters. An imu has floats of 32 bits."""

    adapter = "player"

    def __init__(self, adapters: Mapping[str, Any], epoch_s: float) -> None:
        super().__init__(epoch_s)
        host, _, port = adapters["player"]["address"].rpartition(":")
        self._socket = socket.create_connection((host, int(port)), PATIENCE_S)
        self._stream = self._socket.makefile("rb")
        assert self._stream.read(32).startswith(b"Player v.3")
        self._buffer = b""
        self._thrusters = self._named("one/thrusters")
        for device in ((30, 0), (60, self._named("one/imu", 60)), (51, self._thrusters)):
            self._ask(3, struct.pack(">7I", 0, 0, *device, 1, 0, 0))

    def _send(self, interface: int, number: int, kind: int, subtype: int, body: bytes) -> None:
        self._socket.sendall(struct.pack(">6IdII", 0, 0, interface, number, kind, subtype, 0.0, 0, len(body)) + body)

    def _hear(self) -> tuple[Sequence[int], float, bytes]:
        *head, stamp, _, size = struct.unpack(">6IdII", self._stream.read(40))
        return head[2:], stamp, self._stream.read(size)

    def _ask(self, subtype: int, body: bytes = b"") -> bytes:
        self._send(1, 0, 3, subtype, body)
        while True:
            head, _, said = self._hear()
            if list(head[:2]) == [1, 0]:
                assert head[2] == 4, said
                return said

    def _named(self, driver: str, interface: int = 51) -> int:
        """The number of a device by the name of its driver."""
        said = self._ask(1)
        numbers = struct.unpack(f">{len(said) // 4}I", said)
        for k in range(2, len(numbers), 4):
            if numbers[k + 2] == interface:
                info = self._ask(2, struct.pack(">6I", *numbers[k : k + 4], 0, 0))
                if info[24:].rstrip(b"\0").decode() == driver:
                    return int(numbers[k + 3])
        raise AssertionError(f"no device of {driver}")

    def pump(self, timeout_s: float) -> None:
        self._socket.settimeout(timeout_s)
        with contextlib.suppress(TimeoutError):
            self._buffer += self._socket.recv(1 << 20)
        self._socket.settimeout(PATIENCE_S)
        while len(self._buffer) >= 40:
            *head, stamp, _, size = struct.unpack(">6IdII", self._buffer[:40])
            if len(self._buffer) < 40 + size:
                break
            body, self._buffer = self._buffer[40 : 40 + size], self._buffer[40 + size :]
            if head[2:5] == [60, 0, 1]:
                numbers = struct.unpack(">9f", body)
                self.hear(IMU, stamp, flipped(numbers[:3]), flipped(numbers[3:6]))
            elif head[2:5] == [30, 0, 1]:
                east, north, up, roll, pitch, yaw = struct.unpack(">6d", body[:48])
                self.hear(POSE, stamp, (north, east, -up), quat_from_rpy(roll, -pitch, math.pi / 2 - yaw))

    def command(self, u: Sequence[float]) -> None:
        data = json.dumps({"u": list(u)}).encode()
        body = struct.pack(">II", len(data), len(data)) + data + b"\0" * (-len(data) % 4)
        self._send(51, self._thrusters, 2, 1, body)

    def close(self) -> None:
        self._stream.close()
        self._socket.close()


CLIENTS: Mapping[str, tuple[Callable[[Mapping[str, Any], float], Client], tuple[str, ...]]] = {
    "rosbridge": (Rosbridge, ("rosbags",)),
    "ROS 2 on zenoh": (Ros2, ("rosbags", "xxhash", "zenoh")),
    "ROS 1": (Ros1, ("rosbags",)),
    "MORSE": (Morse, ()),
    "YARP": (Yarp, ()),
    "Player": (Player, ()),
}
"""Each with the modules without which its adapter does not run."""
SINGLE = ("Player",)
"""Those whose imu has floats of 32 bits."""
