"""What clients of the request channel ask, and are answered: without a socket, over a fake server."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from uwserver_adapters.morse.adapter import MorseAdapter
from uwserver_adapters.morse.config import MorseConfig
from uwserver_adapters.morse.grammar import parse
from uwserver_adapters.morse.session import Session

from uwserver.ports import Argument, Field, Port, Reply, Service
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import PORTS, SERVICES

VELOCITY = Port(
    "rov/autopilot/velocity", "actuator", "autopilot",
    (Field("v_B", "m/s", "x", "B", (3,), minimum=-5.0, maximum=5.0), Field("yaw_rate", "rad/s", "x")), "x",
)  # fmt: skip
GOTO = Service(
    "rov/autopilot/goto", "x",
    (
        Argument("position_ned_m", "float", "x", shape=(3,)),
        Argument("heading_deg", "float", "x", required=False),
        Argument("speed_mps", "float", "x", required=False),
        Argument("radius_m", "float", "x", required=False),
    ),
    long_running=True,
)  # fmt: skip
MORE = (
    GOTO,
    Service("rov/autopilot/cancel_goto", "x"),
    Service("rov/autopilot/arm", "x", (Argument("force", "bool", "x", required=False, default=False),)),
    Service("rov/imu/get", "x"),
    Service("rov/imu/set", "x", (Argument("rate_hz", "float", "x", required=False),)),
    Service("rov/imu/activate", "x"),
    Service("rov/imu/deactivate", "x"),
    Service("world/reset", "x"),
    Service("world/shutdown", "x"),
    Service("world/set_speed", "x", (Argument("speed", "float", "x"),)),
)


def fake() -> FakeContext:
    return FakeContext(
        ports={port.path: port for port in (*PORTS, VELOCITY)},
        services={service.path: service for service in (*SERVICES, *MORE)},
    )


@dataclass
class Asker:
    """Asks as a client of pymorse, and reads what comes."""

    context: FakeContext = field(default_factory=fake)
    lines: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.adapter = MorseAdapter(MorseConfig(port=0, stream_port=0), self.context)
        self.session = Session(self.adapter.stage, "test", self.lines.append, 64)

    async def ask(self, line: str) -> tuple[str, str, Any]:
        """Id, status and value of the answer; the status is "" while there is none."""
        del self.lines[:]
        self.session.take(parse(line.encode()))
        for _ in range(4):
            await asyncio.sleep(0)
        return self.heard()

    def heard(self) -> tuple[str, str, Any]:
        if not self.lines:
            return "", "", None
        id, status, *rest = self.lines.pop(0).decode().rstrip("\n").split(" ", 2)
        return id, status, json.loads(rest[0]) if rest else None


Story = Callable[[Asker], Awaitable[None]]


@pytest.fixture
def tell() -> Callable[[Story], None]:
    """Runs a story."""

    def run(story: Story) -> None:
        async def whole() -> None:
            await asyncio.wait_for(story(Asker()), 120)

        asyncio.run(whole())

    return run


def test_what_pymorse_asks_first(tell: Callable[[Story], None]) -> None:
    async def story(asker: Asker) -> None:
        id, status, said = await asker.ask("0 simulation details []")
        assert (id, status) == ("0", "SUCCESS")
        assert [robot["name"] for robot in said["robots"]] == ["rov"]
        assert "rov.imu" in said["robots"][0]["components"]
        assert await asker.ask("1 simulation list_robots") == ("1", "SUCCESS", ["rov"])
        _, status, text = await asker.ask('2 simulation get_stream_port ["rov.imo"]')
        assert status == "FAILED"
        assert 'did you mean "rov.imu"' in text

    tell(story)


def test_data_and_properties(tell: Callable[[Story], None]) -> None:
    async def story(asker: Asker) -> None:
        asker.context.scripts["rov/imu/get"] = lambda args: {"rate_hz": 125.0}
        _, status, said = await asker.ask("1 rov.imu get_local_data")
        assert status == "SUCCESS"
        assert set(said) == {"timestamp", "valid", "linear_acceleration", "angular_velocity", "temperature"}
        assert await asker.ask("2 rov.imu get_properties []") == ("2", "SUCCESS", {"rate_hz": 125.0})
        asker.context.held.add("rov/imu/set")
        await asker.ask('3 rov.imu set_property ["rate_hz", 10]')
        assert asker.context.calls[-1].args == {"rate_hz": 10.0}

    tell(story)


@pytest.mark.parametrize(
    ("line", "service", "args"),
    [
        ("1 simulation reset_objects", "world/reset", {}),
        ("1 simulation suspend_dynamics []", "world/pause", {}),
        ('1 simulation deactivate ["rov.imu"]', "rov/imu/deactivate", {}),
        ("1 simulation quit", "world/shutdown", {}),
        ("1 time set_time_scale [2]", "world/set_speed", {"speed": 2.0}),
        ("1 time sleep [1.5]", "world/run_until", {"t_s": 1.5}),
        ("1 world step [3]", "world/step", {"n": 3}),
        ('1 world step [{"n": 3}]', "world/step", {"n": 3}),
        ("1 rov autopilot_arm [true]", "rov/autopilot/arm", {"force": True}),
        ("1 rov.waypoint goto [1, 2, -3]", "rov/autopilot/goto", {"position_ned_m": [2.0, 1.0, 3.0]}),
        (
            "1 rov.waypoint goto [1, 2, -3, 0.5, 0.25]",
            "rov/autopilot/goto",
            {"position_ned_m": [2.0, 1.0, 3.0], "radius_m": 0.5, "speed_mps": 0.25},
        ),
        ("1 rov.waypoint stop", "rov/autopilot/cancel_goto", {}),
    ],
)
def test_what_is_carried_out(tell: Callable[[Story], None], line: str, service: str, args: dict[str, object]) -> None:
    async def story(asker: Asker) -> None:
        asker.context.held.add(service)
        assert await asker.ask(line) == ("", "", None)
        (call,) = [call for call in asker.context.calls if call.service == service]
        given = {name: value for name, value in call.args.items() if value is not None}
        assert {name: given[name] for name in args} == args
        call.finish(Reply(3, 12))
        assert asker.heard() == ("1", "SUCCESS", None)

    tell(story)


def test_time(tell: Callable[[Story], None]) -> None:
    async def story(asker: Asker) -> None:
        _, _, now = await asker.ask("1 time now")
        assert now == pytest.approx(asker.context.world.epoch_ns / 1e9 + asker.context.tick * 0.004)
        assert await asker.ask("2 time mode") == ("2", "SUCCESS", "lockstep")

    tell(story)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("1 simulation detals []", 'did you mean "details"'),
        ("1 rov.imo get_local_data", 'did you mean "rov.imu"'),
        ("1 rov.imu get_locl_data", 'did you mean "get_local_data"'),
        ("1 rov autopilot_arn", 'did you mean "autopilot_arm"'),
        ("1 world resett", 'did you mean "reset"'),
        ("1 simulation get_stream_port []", "wrong # of parameters"),
        ("1 rov.waypoint goto [1]", "wrong # of parameters"),
        ("1 world step [1, 2]", "wrong # of parameters"),
        ('1 time sleep ["x"]', "is a number"),
        ("1 nobody here", "there are"),
        (f"1 time sleep [{'9' * 400}]", "a number below"),
        (f"1 rov.waypoint goto [{'9' * 400}, 0, 0]", "a number below"),
    ],
)
def test_what_cannot_be_done_is_told(tell: Callable[[Story], None], line: str, text: str) -> None:
    """pymorse raises a TypeError where an answer says "wrong # of parameters"."""

    async def story(asker: Asker) -> None:
        id, status, said = await asker.ask(line)
        assert (id, status) == ("1", "FAILED")
        assert text in said

    tell(story)


def test_cancel_ends_the_call_of_this_client_alone(tell: Callable[[Story], None]) -> None:
    """In MORSE, one client's cancel aborted another's request of the same number."""

    async def story(asker: Asker) -> None:
        asker.context.held.add("rov/autopilot/goto")
        other = Asker(asker.context)
        await asker.ask("0 rov.waypoint goto [1, 2, 3]")
        assert (await other.ask("0 cancel"))[:2] == ("0", "FAILED")
        assert not asker.context.calls[0].is_done
        assert (await asker.ask("0 cancel"))[:2] == ("0", "PREEMPTED")
        assert asker.context.calls[0].is_done

    tell(story)


def test_a_client_that_leaves_ends_its_calls(tell: Callable[[Story], None]) -> None:
    async def story(asker: Asker) -> None:
        asker.context.held.add("rov/autopilot/goto")
        await asker.ask("0 rov.waypoint goto [1, 2, 3]")
        asker.session.conversation.close()
        for _ in range(4):
            await asyncio.sleep(0)
        assert asker.context.calls[0].is_done
        assert asker.heard() == ("", "", None)

    tell(story)


def test_services_that_belong_to_no_vehicle_are_called_by_their_first_level(tell: Callable[[Story], None]) -> None:
    """A recording that is played has ``playback``."""

    async def story(asker: Asker) -> None:
        seek = Service("playback/seek", "x", (Argument("t_s", "float", "x"),))
        asker.context.services = {**asker.context.services, seek.path: seek}
        asker.context.held.add(seek.path)
        await asker.ask("1 playback seek [2.0]")
        assert asker.context.calls[-1].args == {"t_s": 2.0}

    tell(story)
