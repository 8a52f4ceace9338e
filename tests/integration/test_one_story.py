"""One seeded run, every transport and robot middleware on: each tells the same samples, and these are what the world itself made; and a command
through each of them turns the same thruster.

docs/reference/transports.md says how far a wire may round. MOOS tells no samples but variables, one a component: these are compared one by one.
MAVLink tells the newest samples in units of its own: each message is compared with what these units make of them.
"""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import json
import math
import re
import socket
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

import pytest
from middlewares import CLIENTS, IMU, POSE, SINGLE, Client, moment
from nursery import python
from uwserver_adapters.moos import wire as moos
from uwserver_bench.net.wires import Peer, TimedMessage, ZenohPeer, ask, connect
from uwserver_bench.processes import serving

from uwserver.adapter import installed_adapters
from uwserver.ports import Field, Sample
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load

PATIENCE_S = 120
ROUNDS, TICKS = 8, 60
"""So many rounds of a command for each vehicle and so many steps; few enough steps that no datagram is lost."""
HAS_ZENOH = importlib.util.find_spec("zenoh") is not None
HAS_MAVLINK = importlib.util.find_spec("pymavlink") is not None

SCENARIO = """\
schema = 1
title = "one story"
seed = 11

[world.clock]
paused = true

[server]
metrics = false

[vehicles.one]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 8.0]
truth = { rate_hz = 20.0 }

[vehicles.one.sensors.lossy_imu]
kind = "imu"
rate_hz = 60.0
modifiers.noise = { kind = "white_noise", field = "f_S", sigma = 0.1 }
modifiers.walk = { kind = "random_walk", field = "w_S", density = 0.01 }
modifiers.link = { kind = "delay", latency_s = 0.03, jitter_s = 0.01 }
modifiers.loss = { kind = "dropout", probability = 0.2 }

[vehicles.one.sensors.shafts]
kind = "rpm"
rate_hz = 60.0
members = ["t1", "t2", "t3", "t4", "t5", "t6", "t7", "t8"]

# Its markers come out of the water: samples without values.
[vehicles.two]
model = "bluerov2"
position_ned_m = [4.0, 0.0, 0.1]

[vehicles.two.sensors.cameras]
kind = "motion_capture"
rate_hz = 60.0
position_frd_m = [0.0, 0.0, -0.4]

[adapters.tcp]
kind = "sockets"
port = 0
udp_port = 0
udp_lease_s = 600.0  # on a busy machine it listens longer than ten seconds before it says something
truth = true
queue_samples = 4096

[adapters.moosdb]
kind = "moosdb"
port = 0
truth = true
client_timeout_s = 120.0

[adapters.moos_text]
kind = "moos_text"
port = 0
truth = true
"""
ZENOH = """
[adapters.zenoh_json]
kind = "zenoh"
server = "json"
listen = ["tcp/127.0.0.1:0"]
encoding = "json"
truth = true

[adapters.zenoh_msgpack]
kind = "zenoh"
server = "msgpack"
listen = ["tcp/127.0.0.1:0"]
encoding = "msgpack"
truth = true
"""
MAVLINK = """
[adapters.mavlink]
kind = "mavlink"
vehicle = "one"
links = ["tcpin:127.0.0.1:0"]
"""

MIDDLEWARES = {
    "rosbridge": """
[adapters.rosbridge]
kind = "rosbridge"
port = 0
truth = true
""",
    "ROS 2 on zenoh": """
[adapters.ros2]
kind = "ros2"
listen = ["tcp/127.0.0.1:0"]
domain = 0
truth = true
""",
    "ROS 1": """
[adapters.ros1]
kind = "ros1"
master = "http://127.0.0.1:9"
truth = true
""",
    "MORSE": """
[adapters.morse]
kind = "morse"
port = 0
stream_port = 0
truth = true
""",
    "YARP": """
[adapters.yarp]
kind = "yarp"
name_server = "127.0.0.1:9"
ports = ["one/imu", "one/truth/pose", "one/thrusters"]
truth = true
""",
    "Player": """
[adapters.player]
kind = "player"
port = 0
truth = true
pose = "truth"
""",
}
"""Neither a master of ROS nor a name server of YARP is there: these peers find each other without."""


def missing(name: str) -> list[str]:
    """Modules that a middleware lacks here."""
    return [module for module in CLIENTS[name][1] if importlib.util.find_spec(module) is None]


THERE = [name for name in CLIENTS if not missing(name)]
Told = tuple[int, int, bool, dict[str, object]]
Story = dict[tuple[str, int], Told]


def exact(value: object) -> object:
    """What a wire without rounding makes of a value: f64 as it is, and null for what is not a number."""
    if isinstance(value, tuple):
        return [exact(entry) for entry in value]
    return None if isinstance(value, float) and value - value != 0.0 else value


@dataclass(frozen=True)
class Wire:
    """How to connect, given the state of all adapters in `world/status`; and what the wire makes of a value of the world."""

    connect: Callable[[Mapping[str, Any]], Peer]
    expected: Callable[[object], object] = exact


def _tcp(wire: str) -> Wire:
    return Wire(lambda adapters: connect(wire, adapters["tcp"]["address"]))


WIRES: Mapping[str, Wire] = {
    "TCP JSON": _tcp("TCP JSON"),
    "TCP msgpack": _tcp("TCP msgpack"),
    "WebSocket": _tcp("WebSocket"),
    "UDP": Wire(lambda adapters: connect("UDP", adapters["tcp"]["details"]["udp"])),
    "zenoh JSON": Wire(lambda adapters: ZenohPeer(adapters["zenoh_json"]["address"], "json")),
    "zenoh msgpack": Wire(lambda adapters: ZenohPeer(adapters["zenoh_msgpack"]["address"], "msgpack")),
}


class Teller(Protocol):
    """Hears all variables of MOOS."""

    def receive(self, timeout_s: float) -> list[tuple[str, float | str]]:
        """Names and values, in the order in which they came."""

    def close(self) -> None: ...


class MoosTeller:
    """A client of the embedded MOOSDB."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self._socket = socket.create_connection((host, int(port)), PATIENCE_S)
        self._decoder = moos.Decoder()
        hello = moos.MoosMessage(moos.DATA, moos.ASYNCHRONOUS, data=b"teller", kind=moos.STRING)
        asked = moos.MoosMessage(
            moos.WILDCARD_REGISTER, "teller", data=b"AppPattern=*,VarPattern=*,Interval=0", kind=moos.STRING
        )
        self._socket.sendall(moos.HELLO + b"".join(moos.packet([moos.encode(said)]) for said in (hello, asked)))

    def receive(self, timeout_s: float) -> list[tuple[str, float | str]]:
        self._socket.settimeout(timeout_s)
        with contextlib.suppress(TimeoutError):
            self._decoder.receive(self._socket.recv(1 << 20))
        found: list[tuple[str, float | str]] = []
        while isinstance(event := self._decoder.next_event(), moos.Packet | moos.Reading):
            if isinstance(event, moos.Packet):
                found += [(said.key, said.value) for said in event.messages if said.type == moos.NOTIFY]
        return found

    def command(self, u: list[float]) -> None:
        said = moos.notify("ONE_THRUSTERS_U", json.dumps(u), time.time(), "teller")
        self._socket.sendall(moos.packet([moos.encode(said)]))

    def close(self) -> None:
        self._socket.close()


class TextTeller:
    """A user of the text bridge."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self._socket = socket.create_connection((host, int(port)), PATIENCE_S)
        self._socket.sendall(b"SUBSCRIBE *\n")
        self._rest = b""

    def receive(self, timeout_s: float) -> list[tuple[str, float | str]]:
        self._socket.settimeout(timeout_s)
        with contextlib.suppress(TimeoutError):
            self._rest += self._socket.recv(1 << 20)
        *lines, self._rest = self._rest.split(b"\n")
        pairs = (line.decode().partition("=") for line in lines if b"=" in line)
        return [(name, json.loads(value)) for name, _, value in pairs]

    def command(self, u: list[float]) -> None:
        self._socket.sendall(b'ONE_THRUSTERS_U="%s"\n' % json.dumps(u).encode())

    def close(self) -> None:
        self._socket.close()


class MavlinkTeller:
    """A ground station that asks for three messages at 100 Hz; it tells the messages themselves, read by pymavlink."""

    def __init__(self, address: str) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        host, _, port = address.removeprefix("tcpin:").rpartition(":")
        self._socket = socket.create_connection((host, int(port)), PATIENCE_S)
        self._mav = ardupilotmega.MAVLink(self, srcSystem=255, srcComponent=190)
        for number in (27, 137, 33):
            self._mav.command_long_send(1, 1, 511, 0, number, 10_000, 0, 0, 0, 0, 0)

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    def receive(self, timeout_s: float) -> list[tuple[str, Any]]:
        self._socket.settimeout(timeout_s)
        data = b""
        with contextlib.suppress(TimeoutError):
            data = self._socket.recv(1 << 20)
        found = [(message.get_type(), message) for message in self._mav.parse_buffer(data) or []]
        return [pair for pair in found if pair[0] in ("RAW_IMU", "SCALED_PRESSURE2", "GLOBAL_POSITION_INT")]

    def close(self) -> None:
        self._socket.close()


TELLERS: Mapping[str, Callable[[Mapping[str, Any]], Teller]] = {
    "MOOS": lambda adapters: MoosTeller(adapters["moosdb"]["address"]),
    "MOOS text lines": lambda adapters: TextTeller(adapters["moos_text"]["address"]),
}
GROUND: Mapping[str, Callable[[Mapping[str, Any]], Teller]] = (
    {"MAVLink": lambda adapters: MavlinkTeller(adapters["mavlink"]["address"])} if HAS_MAVLINK else {}
)
Variables = dict[str, list[tuple[float, float | str]]]
"""Of each variable: simulation time (s) and value, in their order."""


@dataclass(frozen=True)
class Heard:
    """What came over each wire."""

    messages: dict[str, list[TimedMessage]]
    variables: dict[str, list[tuple[str, float | str]]]
    middlewares: dict[str, Client]
    turned: dict[str, object]
    """What the shafts did that each commanded."""


def commands(turn: int) -> dict[str, list[float]]:
    push = 0.1 + 0.05 * turn
    return {"one/thrusters": [push, push, -push, -push, 0.3, 0.3, 0.3, 0.3], "two/thrusters": [push] * 4 + [-0.2] * 2}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("story") / "story.toml"
    tables = [MIDDLEWARES[name] for name in THERE]
    file.write_text("".join([SCENARIO, ZENOH if HAS_ZENOH else "", MAVLINK if HAS_MAVLINK else "", *tables]))
    return file


@pytest.fixture(scope="module")
def made(scenario: Path) -> tuple[list[Sample], Mapping[str, tuple[Field, ...]]]:
    """The samples of the world alone, and the fields of each port."""
    world = build(load(scenario, adapters=installed_adapters()))
    samples: list[Sample] = []
    for turn in range(ROUNDS):
        for port, u in commands(turn).items():
            world.command(port, u=u)
        samples += world.step(TICKS)
    return samples, {path: port.fields for path, port in world.ports.items()}


TURNED = [0.0, 0.0, 0.4, 0.0, 0.0, -0.25, 0.0, 0.0]
"""Each protocol alone turns these two thrusters."""


@pytest.fixture(scope="module")
def heard(scenario: Path, made: tuple[list[Sample], Any]) -> Heard:
    """What came over each wire, all of them listening at once; then what each of them turned."""
    with serving(scenario, python=python()) as served, contextlib.ExitStack() as stack:
        room = _everybody(stack, f"{served.host}:{served.port}")
        everything: dict[str, list[TimedMessage]] = {name: [] for name in room.peers}
        variables: dict[str, list[tuple[str, float | str]]] = {name: [] for name in room.tellers}
        for name, peer in room.peers.items():
            ask(peer, "subscribe", seen=everything[name], pattern="**")
        for turn in range(ROUNDS):
            for identity, (port, u) in enumerate(commands(turn).items()):
                room.driver.send("command", {"port": port, "value": {"u": u}}, identity)
            ask(room.driver, "step", PATIENCE_S, n=TICKS)
            for name, peer in room.peers.items():
                everything[name] += peer.receive(0.2)
            for name, teller in room.tellers.items():
                variables[name] += teller.receive(0.2)
            for client in room.clients.values():
                client.pump(0.05)
        for name, peer in room.peers.items():
            _complete(peer, everything[name], len(made[0]))
        for name, teller in room.tellers.items():
            while more := teller.receive(1.0):
                variables[name] += [pair for pair in more if not pair[0].startswith("DB_")]
                if not variables[name] or variables[name][-1] == ("UWSERVER_TIME", made[0][-1].t_sent_ns / 1e9):
                    break
        wanted = sum(sample.port in (IMU, POSE) for sample in made[0])
        end = time.monotonic() + PATIENCE_S
        while any(client.count() < wanted for client in room.clients.values()) and time.monotonic() < end:
            for client in room.clients.values():
                client.pump(0.05)
        return Heard(everything, variables, room.clients, _turned(room))


def _turned(room: Room) -> dict[str, object]:
    """Each commands a world that stands at its beginning, and nobody else does."""
    driver, found = room.driver, {}
    ask(driver, "subscribe", pattern="one/shafts")
    adapters = {
        "MOOS": "moosdb",
        "MOOS text lines": "moos_text",
        "zenoh JSON": "zenoh_json",
        "zenoh msgpack": "zenoh_msgpack",
    }
    for identity, (name, way) in enumerate({**room.peers, **room.tellers, **room.clients}.items()):
        if name == "MAVLink":  # it has no word for two thrusters alone: test_mavlink.py turns one by its motor test
            continue
        ask(driver, "call", service="world/reset")
        adapter = way.adapter if isinstance(way, Client) else adapters.get(name, "tcp")
        before = _commands(driver, adapter)
        if name in room.peers:
            peer = (
                room.peers[name] if name != "UDP" else room.newcomer(name)
            )  # who was silent for long is forgotten there
            peer.send("command", {"port": "one/thrusters", "value": {"u": TURNED}}, identity)
        else:
            way.command(TURNED)  # type: ignore[union-attr]  # no Peer
        end = time.monotonic() + PATIENCE_S
        while _commands(driver, adapter) == before and time.monotonic() < end:
            time.sleep(0.01)
        seen: list[TimedMessage] = []
        ask(driver, "step", PATIENCE_S, seen=seen, n=TICKS)
        samples = [message.body["params"] for message in seen if message.body.get("method") == "sample"]
        found[name] = [(sample["t_ns"], sample["value"]["speeds"]) for sample in samples]
    return found


def _commands(driver: Peer, adapter: str) -> int:
    """Commands that an adapter has posted: what is stepped after this has them."""
    return int(ask(driver, "call", service="world/status")["value"]["adapters"][adapter]["commands"])


@dataclass(frozen=True)
class Room:
    """Everybody who is connected."""

    driver: Peer
    peers: dict[str, Peer]
    tellers: dict[str, Teller]
    clients: dict[str, Client]
    newcomer: Callable[[str], Peer]
    """One more on a wire."""


def _everybody(stack: contextlib.ExitStack, address: str) -> Room:
    driver = stack.enter_context(contextlib.closing(connect("TCP JSON", address)))
    adapters = ask(driver, "call", service="world/status")["value"]["adapters"]
    epoch = datetime.fromisoformat(ask(driver, "describe", pattern="none")["world"]["epoch_utc"].replace("Z", "+00:00"))
    peers: dict[str, Peer] = {}
    for name, wire in WIRES.items():
        if HAS_ZENOH or "zenoh" not in name:
            peers[name] = stack.enter_context(contextlib.closing(wire.connect(adapters)))
    tellers: dict[str, Teller] = {}
    for name, make in {**TELLERS, **GROUND}.items():
        tellers[name] = stack.enter_context(contextlib.closing(make(adapters)))
    clients: dict[str, Client] = {}
    for name in THERE:
        clients[name] = stack.enter_context(contextlib.closing(CLIENTS[name][0](adapters, epoch.timestamp())))
    time.sleep(3.0)  # zenoh tells a publisher a little later that somebody subscribes, and nobody can ask
    ask(driver, "call", service="world/status")  # answered after what the server was told until now

    def newcomer(name: str) -> Peer:
        return stack.enter_context(contextlib.closing(WIRES[name].connect(adapters)))

    return Room(driver, peers, tellers, clients, newcomer)


def _complete(peer: Peer, messages: list[TimedMessage], count: int) -> None:
    """Listen until all is there, and a little longer, in case that too much comes; the test says what is missing."""
    end = time.monotonic() + PATIENCE_S
    while sum(message.body.get("method") == "sample" for message in messages) < count and time.monotonic() < end:
        messages += peer.receive(0.1)
    messages += peer.receive(0.1)


def told(messages: list[TimedMessage]) -> Story:
    story: Story = {}
    for message in messages:
        if message.body.get("method") == "sample":
            said = message.body["params"]
            key = (said["port"], said["seq"])
            assert key not in story, f"{key} came twice"
            story[key] = (said["t_ns"], said["t_sent_ns"], said["valid"], said["value"])
    return story


def expected(made: tuple[list[Sample], Mapping[str, tuple[Field, ...]]], wire: Wire) -> Story:
    samples, fields = made
    return {
        (s.port, s.seq): (
            s.t_ns, s.t_sent_ns, s.valid,
            {field.name: wire.expected(value) for field, value in zip(fields[s.port], s.value, strict=True)},
        )
        for s in samples
    }  # fmt: skip


def words(port: str, field: Field) -> list[str]:
    """Variables of a field, by the rules of docs/how-to/moos.md."""
    name = re.sub(r"\W", "_", f"{port}_{field.name}").upper()
    if not field.shape:
        return [name]
    if field.is_rotation:
        return [f"{name}_{word}" for word in "WXYZ"]
    return [f"{name}_{word}" for word in ("XYZ" if field.shape == (3,) and field.frame else range(field.size))]


def expected_variables(made: tuple[list[Sample], Mapping[str, tuple[Field, ...]]]) -> Variables:
    samples, fields = made
    expected: Variables = {}
    was_valid: dict[str, bool] = {}
    for s in samples:
        values: list[tuple[str, object]] = []
        if was_valid.get(s.port, True) != s.valid:
            values.append((re.sub(r"\W", "_", f"{s.port}_valid").upper(), str(s.valid).lower()))
        was_valid[s.port] = s.valid
        for field, value in zip(fields[s.port], s.value, strict=True):
            values += zip(
                words(s.port, field), value if isinstance(value, tuple) else itertools.repeat(value), strict=False
            )
        for name, number in values:
            if isinstance(number, bool):
                number = str(number).lower()
            if number is not None and not (isinstance(number, float) and not math.isfinite(number)):
                expected.setdefault(name, []).append((s.t_sent_ns / 1e9, number))  # type: ignore[arg-type]
    return expected


@pytest.mark.parametrize("name", TELLERS)
def test_moos_tells_each_number_exactly(heard, made, name):
    """No quantisation: f64 as it is. Not told are `seq` and the time of the measurement; `UWSERVER_TIME`, that of sending, ends each packet."""
    story: Variables = {}
    untimed: list[tuple[str, float | str]] = []
    for variable, value in heard.variables[name]:
        if variable == "UWSERVER_TIME":
            for key, number in untimed:
                story.setdefault(key, []).append((float(value), number))
            untimed.clear()
        elif variable.startswith(("ONE_", "TWO_")):
            untimed.append((variable, value))
    truth = expected_variables(made)
    assert story.keys() == truth.keys()
    for key, values in truth.items():
        assert [value for _, value in story[key]] == [value for _, value in values], key
        # A delayed sample is sent between two ticks; the packet is that of the tick.
        assert all(abs(told - sent) < 1 / 240 for (told, _), (sent, _) in zip(story[key], values, strict=True)), key
    assert any(key.endswith("_VALID") for key in truth)


@pytest.mark.skipif(not HAS_MAVLINK, reason="pymavlink is not installed")
def test_mavlink_tells_the_newest_samples_in_its_units(heard, made):
    """RAW_IMU in mg and mrad/s, SCALED_PRESSURE2 in hPa and 0.01 degC, the depth of GLOBAL_POSITION_INT in mm, upwards; 16 and 32 bits."""
    samples, _ = made

    def newest(port: str, t_ns: int) -> Sample | None:
        """The last that was sent by then."""
        return next((s for s in reversed(samples) if s.port == port and s.t_sent_ns <= t_ns), None)

    compared = dict.fromkeys(("RAW_IMU", "SCALED_PRESSURE2", "GLOBAL_POSITION_INT"), 0)
    for name, message in heard.variables["MAVLink"]:
        # Its time is cut to whole microseconds or milliseconds: no sample is sent within the rest.
        t_ns = message.time_usec * 1000 + 999 if name == "RAW_IMU" else message.time_boot_ms * 1_000_000 + 999_999
        imu, pressure, depth = (newest(f"one/{kind}", t_ns) for kind in ("imu", "pressure", "depth"))
        if name == "RAW_IMU" and imu is not None:
            f, w, _ = imu.value
            told = [getattr(message, f"{axis}{kind}") for kind in ("acc", "gyro") for axis in "xyz"]
            assert told == [round(x / 9.80665 * 1000) for x in f] + [round(x * 1000) for x in w], (name, t_ns)
        elif name == "SCALED_PRESSURE2" and pressure is not None:
            value, temperature = pressure.value
            assert struct.pack("<f", message.press_abs) == struct.pack("<f", value / 100), (name, t_ns)
            assert message.temperature == round(temperature * 100), (name, t_ns)
        elif name == "GLOBAL_POSITION_INT" and depth is not None:
            assert message.alt == message.relative_alt == round(-depth.value[0] * 1000), (name, t_ns)
        else:
            continue
        compared[name] += 1
    assert min(compared.values()) > 100, compared


@pytest.mark.parametrize("name", WIRES)
def test_every_wire_tells_what_the_world_made(heard, made, name):
    if name not in heard.messages:
        pytest.skip("eclipse-zenoh is not installed")
    story, truth = told(heard.messages[name]), expected(made, WIRES[name])
    assert story.keys() == truth.keys()
    different = [key for key in truth if story[key] != truth[key]]
    assert not different, f"{different[0]}: {story[different[0]]} instead of {truth[different[0]]}"


def is_there(name: str) -> None:
    if missing(name):
        pytest.skip(f"{', '.join(missing(name))} not installed")


@pytest.mark.parametrize("name", CLIENTS)
def test_every_middleware_tells_what_the_world_made(heard, made, name):
    """In axes, units and stamps of its own; f64 as it is where the protocol has these. Attitudes are turned, and so rounded."""
    is_there(name)
    truth: dict[str, dict[int, tuple[float, ...]]] = {IMU: {}, POSE: {}}
    for sample in made[0]:
        if sample.port in truth:
            truth[sample.port][moment(sample.t_ns / 1e9)] = (*sample.value[0], *sample.value[1])
    story = heard.middlewares[name].told
    # A place and a velocity together are one message, of which the last may still wait for its other half.
    assert story[IMU].keys() == truth[IMU].keys()
    assert story[POSE].keys() == truth[POSE].keys()
    single = struct.Struct("<6f")
    for key, numbers in truth[IMU].items():
        expected = single.unpack(single.pack(*numbers)) if name in SINGLE else numbers
        assert story[IMU][key] == expected, (name, key)
    for key, numbers in truth[POSE].items():
        assert story[POSE][key][:3] == numbers[:3], (name, key)
        sign = math.copysign(1.0, sum(a * b for a, b in zip(story[POSE][key][3:], numbers[3:], strict=True)))
        assert [sign * q for q in story[POSE][key][3:]] == pytest.approx(numbers[3:], abs=1e-9), (name, key)
    assert min(len(told) for told in story.values()) > 30


@pytest.fixture(scope="module")
def shafts(scenario: Path) -> list[tuple[int, list[float]]]:
    """Time and speeds, as the world alone turns them."""
    world = build(load(scenario, adapters=installed_adapters()))
    world.command("one/thrusters", u=TURNED)
    return [(s.t_ns, list(s.value[0])) for s in world.step(TICKS) if s.port == "one/shafts"]  # type: ignore[arg-type]  # numbers


@pytest.mark.parametrize("name", [*WIRES, *TELLERS, *CLIENTS])
def test_a_command_through_each_protocol_turns_the_same_thrusters(heard, shafts, name):
    """Bit for bit as the world alone turns them."""
    if name in CLIENTS:
        is_there(name)
    if name not in heard.turned:
        pytest.skip("eclipse-zenoh is not installed")
    assert heard.turned[name] == shafts
    speeds = shafts[-1][1]
    assert speeds[2] > 50.0
    assert speeds[5] < -20.0
    assert [k for k, speed in enumerate(speeds) if speed] == [2, 5]


def test_the_order_of_each_port_is_kept(heard, made):
    order = [(s.port, s.seq) for s in made[0]]
    for name, messages in heard.messages.items():
        came = list(told(messages))
        for port in {port for port, _ in order}:
            mine = [key for key in came if key[0] == port]
            assert mine == [key for key in order if key[0] == port], f"{name}: {port}"


def test_the_story_is_worth_telling(made):
    """Two vehicles, delays, losses and truth are in it, or the comparison would prove little."""
    samples, _ = made
    lossy = [s.seq for s in samples if s.port == "one/lossy_imu"]
    assert len(lossy) < max(lossy)
    assert any(s.t_sent_ns > s.t_ns for s in samples)
    assert len({s.t_sent_ns - s.t_ns for s in samples if s.port == "one/lossy_imu"}) > 10
    assert {s.port.split("/")[0] for s in samples} == {"one", "two"}
    assert any("/truth/" in s.port for s in samples)
    assert not all(s.valid for s in samples)
    assert len(samples) > 500
