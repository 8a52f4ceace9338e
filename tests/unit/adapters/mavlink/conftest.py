"""An ROV with a scripted autopilot, and a ground station that writes with pymavlink, for tests of the MAVLink adapter."""

from __future__ import annotations

import asyncio
import functools
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest
from adapter_rig import serving
from pymavlink.dialects.v20 import ardupilotmega as pymavlink
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.vehicle.config import MavlinkConfig
from uwserver_adapters.mavlink.wire.dialect import Dialect

from uwserver.ports import Argument, Field, Json, Port, Refused, Sample, Service, Value
from uwserver.recording.channels import message_of
from uwserver.testing import FakeContext

NAN = math.nan
STATE: dict[str, tuple[Any, dict[str, Any]]] = {
    "mode": ("manual", {"type": "str"}),
    "armed": (False, {"type": "bool"}),
    "p_N": ((1.0, 2.0, 5.0), {"shape": (3,)}),
    "position_valid": (True, {"type": "bool"}),
    "v_N": ((0.1, 0.2, 0.3), {"shape": (3,)}),
    "velocity_valid": (True, {"type": "bool"}),
    "q_NB": ((1.0, 0.0, 0.0, 0.0), {"shape": (4,)}),
    "w_B": ((0.01, 0.02, 0.03), {"shape": (3,)}),
    "depth": (5.0, {}),
    "altitude": (NAN, {}),
    "p_ref_N": ((NAN, NAN, NAN), {"shape": (3,)}),
    "depth_ref": (NAN, {}),
    "heading_ref": (NAN, {}),
    "mission_index": (-1, {"type": "int"}),
    "mission_count": (0, {"type": "int"}),
    "reached": (0, {"type": "int"}),
    "tau": ((0.0,) * 6, {"shape": (6,)}),
    "failsafe": ("", {"type": "str"}),
    "outputs": ((0.0,) * 8, {"shape": (8,)}),
}
INSTRUMENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "imu": ("imu", {"f_S": (0.0, 0.0, -9.80665), "w_S": (0.01, -0.02, 0.03), "temperature": 12.5}),
    "pressure": ("pressure", {"pressure": 150_000.0, "temperature": 12.5}),
    "depth": ("pressure", {"depth": 5.0, "temperature": 12.5}),
    "echo": ("altimeter", {"range": 7.25, "confidence": 0.5}),
    "battery": ("battery", {"voltage": 15.2, "current": 3.5, "power": 53.2, "energy": 12_000.0, "charge": 0.75}),
    "leak": ("leak", {"leak": False}),
    "gps": ("gps", {"latitude": 1.0, "longitude": 0.2, "height": 0.5, "v_NS": (1.0, 1.0, 0.0), "horizontal_accuracy": 1.5,
                    "vertical_accuracy": 2.5, "velocity_accuracy": 0.1, "satellites": 9, "fix": 3}),
}  # fmt: skip
SET_POINTS = {
    "pilot": [("u", (6,), 1.0)],
    "depth": [("depth", (), 1e4)],
    "altitude": [("altitude", (), 1e4)],
    "heading": [("heading", (), 100.0), ("rate", (), 10.0)],
    "attitude": [("q_NB", (4,), 1e6), ("heave", (), 1.0)],
    "velocity": [("v_B", (3,), 20.0), ("v_N", (3,), 20.0), ("yaw_rate", (), 10.0), ("heading", (), 100.0)],
    "position": [("p_N", (3,), 1e6), ("heading", (), 100.0)],
    "test": [("outputs", (8,), 1.0)],
}
MODES = [
    "manual",
    "stabilise",
    "acro",
    "depth_hold",
    "altitude_hold",
    "heading_hold",
    "position_hold",
    "velocity",
    "guided",
    "mission",
    "surface",
]
SERVICES = {
    "arm": (Argument("force", "bool", "x", required=False, default=False),),
    "disarm": (),
    "set_mode": (Argument("mode", "str", "x", choices=tuple(MODES)),),
    "set_mission": (Argument("items", "json", "x"),),
    "get_mission": (),
    "start_mission": (Argument("index", "int", "x", required=False, default=0),),
    "clear_mission": (),
    "set_gain": (Argument("name", "str", "x"), Argument("value", "float", "x")),
}


def _fields(values: Mapping[str, Any]) -> tuple[Field, ...]:
    return tuple(Field(name, "1", "x", shape=(len(v),) if isinstance(v, tuple) else ()) for name, v in values.items())


class FakeRov(FakeContext):
    """A world with one vehicle `rov`: values stand as the test sets them, and services change the state as the autopilot does."""

    def __init__(self, has_autopilot: bool = True, thrusters: int = 8) -> None:
        self.state: dict[str, Any] = {name: value for name, (value, _) in STATE.items()}
        self.said: dict[str, dict[str, Any]] = {name: dict(values) for name, (_, values) in INSTRUMENTS.items()}
        self.invalid: set[str] = set()
        self.until_s = 0.0
        self.state_of: tuple[int, dict[str, Any]] | None = None
        self.items: list[Json] = []
        self.refusal = ""
        ports = [
            Port(f"rov/{name}", "sensor", kind, _fields(values), "x", 10.0, message=message_of({"kind": kind}))
            for name, (kind, values) in INSTRUMENTS.items()
        ]
        ports.append(Port("rov/thrusters", "actuator", "thrusters", (Field("u", "1", "x", shape=(thrusters,)),), "x"))
        services: list[Service] = []
        if has_autopilot:
            fields = tuple(Field(name, "1", "x", **more) for name, (_, more) in STATE.items())
            ports.append(Port("rov/autopilot/state", "sensor", "autopilot", fields, "x", 10.0, message="Estimate"))
            for name, entries in SET_POINTS.items():
                if name == "test":
                    entries = [("outputs", (thrusters,), 1.0)]
                wanted = tuple(Field(f, "1", "x", shape=s, minimum=-m, maximum=m) for f, s, m in entries)
                timeout_s = 0.5 if name == "test" else 1.0
                ports.append(Port(f"rov/autopilot/{name}", "actuator", "autopilot", wanted, "x", timeout_s=timeout_s))
            services = [Service(f"rov/autopilot/{name}", "x", arguments) for name, arguments in SERVICES.items()]
        super().__init__(ports={p.path: p for p in ports}, services={s.path: s for s in services})
        for name in SERVICES:
            self.scripts[f"rov/autopilot/{name}"] = getattr(self, f"_{name}")

    def last(self, port: str) -> Sample | None:
        name = port.removeprefix("rov/")
        if port not in self.ports or self.ports[port].direction == "actuator":
            return None
        values: Mapping[str, Value] = self.state if name == "autopilot/state" else self.said[name]
        t_ns = self.tick * 4_000_000
        if name == "autopilot/state" and self.state_of is not None:
            t_ns, values = self.state_of
        return Sample(port, self.tick, t_ns, t_ns, name not in self.invalid, tuple(values.values()))

    def advance(self, seconds: float) -> None:
        """Simulation time goes on by ticks of 4 ms; each brings a sample."""
        self.until_s = (self.until_s if self.tick * 0.004 - self.until_s < 0.01 else self.tick * 0.004) + seconds
        while self.tick * 0.004 < self.until_s - 1e-9:
            self.tick += 1
            sample = self.last("rov/imu")
            assert sample is not None
            self.put([sample])

    def commanded(self, port: str) -> list[dict[str, tuple[float, ...]]]:
        """Commands to a set point, oldest first."""
        names = [f.name for f in self.ports[f"rov/autopilot/{port}"].fields]
        return [
            {name: value for name, value in zip(names, c.value, strict=True) if value is not None}
            for c in self.commands
            if c.port == f"rov/autopilot/{port}"
        ]

    def _arm(self, args: Mapping[str, Json]) -> Json:
        if self.said["leak"]["leak"] and not args["force"]:
            raise Refused("denied", "there is water in the hull")
        self.state["armed"] = True
        return None

    def _disarm(self, _: Mapping[str, Json]) -> Json:
        self.state["armed"] = False
        return None

    def _set_mode(self, args: Mapping[str, Json]) -> Json:
        if args["mode"] in ("position_hold", "guided", "mission") and not self.state["position_valid"]:
            raise Refused("denied", "no position")
        if args["mode"] == "mission" and not self.items:
            raise Refused("denied", "there is no mission: call rov/autopilot/set_mission first")
        self.state["mode"] = args["mode"]
        return None

    def _set_mission(self, args: Mapping[str, Json]) -> Json:
        items = args["items"]
        assert isinstance(items, list)
        if self.refusal:
            raise Refused("denied", self.refusal)
        self.items = items
        self.state |= {"mission_count": len(items), "mission_index": -1, "reached": 0}
        return {"count": len(items)}

    def _get_mission(self, _: Mapping[str, Json]) -> Json:
        return {"items": self.items, "index": self.state["mission_index"], "reached": self.state["reached"]}

    def _start_mission(self, args: Mapping[str, Json]) -> Json:
        if not self.items:
            raise Refused("denied", "there is no mission")
        self.state |= {"mode": "mission", "mission_index": args["index"], "reached": 0}
        return None

    def _clear_mission(self, _: Mapping[str, Json]) -> Json:
        return self._set_mission({"items": []})

    def _set_gain(self, args: Mapping[str, Json]) -> Json:
        self.state["gain"] = args
        self.state.pop("gain")
        return None


class _Buffer:
    def write(self, data: bytes) -> None:
        raise AssertionError("nothing writes here")


@dataclass
class Station:
    """A ground station on one channel: pymavlink writes and reads, so that two independent codecs meet."""

    router: Router
    system: int = 255
    component: int = 190
    name: str = "udp:test"
    heard: list[Any] = field(default_factory=list)
    is_ready: bool = True

    def __post_init__(self) -> None:
        self.mav = pymavlink.MAVLink(_Buffer(), srcSystem=self.system, srcComponent=self.component)
        self.mav.robust_parsing = True
        self.channel = self.router.open(self.name, self._take, lambda: self.is_ready)

    def _take(self, data: bytes) -> bool:
        self.heard += self.mav.parse_buffer(data) or []
        return True

    def bytes_of(self, name: str, *values: Any, **named: Any) -> bytes:
        """A frame of a message."""
        message = getattr(pymavlink, f"MAVLink_{name.lower()}_message")(*values, **named)
        data = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return data

    def send(self, name: str, *values: Any, **named: Any) -> None:
        """Say a message."""
        self.router.receive(self.channel, self.bytes_of(name, *values, **named))

    def of(self, name: str) -> list[Any]:
        """All heard of a kind."""
        return [m for m in self.heard if m.get_type() == name]

    def last(self, name: str) -> Any:
        """The newest of a kind."""
        found = self.of(name)
        assert found, f"no {name} was heard, but {sorted({m.get_type() for m in self.heard})}"
        return found[-1]

    def texts(self) -> list[str]:
        """STATUSTEXTs, put together where they came in pieces."""
        found: list[str] = []
        for message in self.of("STATUSTEXT"):
            if message.chunk_seq:
                found[-1] += message.text
            else:
                found.append(message.text)
        return found

    async def command(self, number: int, *p: float, target: int = 1) -> int | None:
        """COMMAND_LONG; the result of its acknowledgement, None for silence."""
        before = len(self.of("COMMAND_ACK"))
        self.send("COMMAND_LONG", target, 1, number, 0, *(*p, *(0.0,) * 7)[:7])
        return await self._result(number, before)

    async def command_int(self, number: int, p: tuple[float, ...], x: int, y: int, z: float, frame: int = 6) -> int | None:  # fmt: skip
        """COMMAND_INT; as `command`."""
        before = len(self.of("COMMAND_ACK"))
        self.send("COMMAND_INT", 1, 1, frame, number, 0, 0, *p, x, y, z)
        return await self._result(number, before)

    async def _result(self, number: int, before: int) -> int | None:
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        acks = self.of("COMMAND_ACK")[before:]
        assert len(acks) <= 1
        if not acks:
            return None
        assert (acks[0].command, acks[0].target_system, acks[0].target_component) == (
            number,
            self.system,
            self.component,
        )
        return int(acks[0].result)


dialect = functools.cache(Dialect)
"""All benches read the same one."""


class Bench:
    """A router over a fake world, with a clock that the test moves."""

    def __init__(self, has_autopilot: bool = True, thrusters: int = 8, **table: Any) -> None:
        self.rov = FakeRov(has_autopilot, thrusters)
        self.now = 1000.0
        table.setdefault("origin_deg", (63.44, 10.39))
        config = MavlinkConfig(**table)
        self.router = Router(config, self.rov, "rov", dialect(), lambda: self.now, 1_750_000_000.0)
        self.rov.attach(self.router)

    @property
    def vehicle(self) -> Any:
        return self.router.vehicle

    @property
    def counters(self) -> Any:
        return self.router.vehicle.bridge.counters

    def station(self, system: int = 255, component: int = 190) -> Station:
        return Station(self.router, system, component)

    def run(self, seconds: float) -> None:
        """Simulation and wall time go on together."""
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            self.rov.advance(0.05)
            self.router.tick()


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    return Bench


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Tests of this folder may be coroutines; each runs within a loop, and has two minutes."""
    function = pyfuncitem.obj
    arguments = {name: pyfuncitem.funcargs[name] for name in inspect.signature(function).parameters}

    async def within_a_loop() -> None:
        result = function(**arguments)
        if inspect.isawaitable(result):
            await result

    asyncio.run(asyncio.wait_for(within_a_loop(), 120.0))
    return True


@pytest.fixture
def serve() -> Callable[..., Any]:
    return serving


@pytest.fixture
def make_rov() -> Callable[..., FakeRov]:
    return FakeRov
