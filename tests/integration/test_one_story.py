"""One seeded run, every transport on: each tells the same samples, and these are what the world itself made.

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
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pytest
from uwserver_adapters.moos import wire as moos
from uwserver_bench.processes import serving
from uwserver_bench.wires import Message, Peer, ZenohPeer, ask, connect

from uwserver.adapter import installed_adapters
from uwserver.ports import Field, Sample
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load

PATIENCE_S = 30
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
        hello = moos.Message(moos.DATA, moos.ASYNCHRONOUS, data=b"teller", kind=moos.STRING)
        asked = moos.Message(
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

    messages: dict[str, list[Message]]
    variables: dict[str, list[tuple[str, float | str]]]


def commands(turn: int) -> dict[str, list[float]]:
    push = 0.1 + 0.05 * turn
    return {"one/thrusters": [push, push, -push, -push, 0.3, 0.3, 0.3, 0.3], "two/thrusters": [push] * 4 + [-0.2] * 2}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("story") / "story.toml"
    file.write_text(SCENARIO + (ZENOH if HAS_ZENOH else "") + (MAVLINK if HAS_MAVLINK else ""))
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


@pytest.fixture(scope="module")
def heard(scenario: Path, made: tuple[list[Sample], Any]) -> Heard:
    """What came over each wire, all of them listening at once."""
    with serving(scenario) as served, _everybody(f"{served.host}:{served.port}") as (driver, peers, tellers):
        everything: dict[str, list[Message]] = {name: [] for name in peers}
        variables: dict[str, list[tuple[str, float | str]]] = {name: [] for name in tellers}
        for name, peer in peers.items():
            ask(peer, "subscribe", seen=everything[name], pattern="**")
        for turn in range(ROUNDS):
            for identity, (port, u) in enumerate(commands(turn).items()):
                driver.send("command", {"port": port, "value": {"u": u}}, identity)
            ask(driver, "step", PATIENCE_S, n=TICKS)
            for name, peer in peers.items():
                everything[name] += peer.receive(0.2)
            for name, teller in tellers.items():
                variables[name] += teller.receive(0.2)
        for name, peer in peers.items():
            _complete(peer, everything[name], len(made[0]))
        for name, teller in tellers.items():
            while more := teller.receive(1.0):
                variables[name] += [pair for pair in more if not pair[0].startswith("DB_")]
                if not variables[name] or variables[name][-1] == ("UWSERVER_TIME", made[0][-1].t_sent_ns / 1e9):
                    break
        return Heard(everything, variables)


@contextlib.contextmanager
def _everybody(address: str) -> Iterator[tuple[Peer, dict[str, Peer], dict[str, Teller]]]:
    with contextlib.ExitStack() as stack:
        driver = stack.enter_context(contextlib.closing(connect("TCP JSON", address)))
        adapters = ask(driver, "call", service="world/status")["value"]["adapters"]
        peers: dict[str, Peer] = {}
        for name, wire in WIRES.items():
            if HAS_ZENOH or "zenoh" not in name:
                peers[name] = stack.enter_context(contextlib.closing(wire.connect(adapters)))
        tellers: dict[str, Teller] = {}
        for name, make in {**TELLERS, **GROUND}.items():
            tellers[name] = stack.enter_context(contextlib.closing(make(adapters)))
        yield driver, peers, tellers


def _complete(peer: Peer, messages: list[Message], count: int) -> None:
    """Listen until all is there, and a little longer, in case that too much comes; the test says what is missing."""
    end = time.monotonic() + PATIENCE_S
    while sum(message.body.get("method") == "sample" for message in messages) < count and time.monotonic() < end:
        messages += peer.receive(0.1)
    messages += peer.receive(0.1)


def told(messages: list[Message]) -> Story:
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
