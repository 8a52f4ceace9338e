"""Vehicles that fly by themselves, on simulated sensors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from scenario_rig import read_once

from uwserver.ports import Call, Command, Progress, Reply
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.world import World

RATE = 240


class Flight:
    """A world with one vehicle `v`, and short words to fly it."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.events: list[str] = []

    def call(self, service: str, **args: Any) -> Any:
        """A service of the autopilot."""
        return self.world.call(f"v/autopilot/{service}", **args)

    def post(self, service: str, **args: Any) -> list[Reply | Progress]:
        """A call as a client makes it; its answers gather in the list as time goes on."""
        answers: list[Reply | Progress] = []
        service = f"v/autopilot/{service}"
        defaults = {a.name: a.default for a in self.world.services[service].arguments if not a.required}
        self.world.submit(Call(service, {**defaults, **args}), answers.append)
        return answers

    def send(self, port: str, **value: Any) -> None:
        """A command to one of its ports."""
        self.world.command(f"v/autopilot/{port}", **value)

    def run(self, seconds: float, **streams: dict[str, Any]) -> None:
        """Let time pass; `streams` are commands repeated at 10 Hz."""
        left = round(seconds * RATE)
        while left > 0:
            for port, value in streams.items():
                self.send(port, **value)
            turn = min(left, 24) if streams else left
            self._advance(turn)
            left -= turn

    def _advance(self, ticks: int) -> None:
        end = self.world.tick + ticks
        while self.world.tick < end:
            output = self.world.advance(most=end - self.world.tick)
            self.events += [event.text for event in output.events]
            for on_reply, reply in output.replies:
                on_reply(reply)

    @property
    def vehicle(self) -> Any:
        """As it truly is."""
        return self.world.vehicles["v"]

    @property
    def state(self) -> dict[str, Any]:
        """What the autopilot says now."""
        path = "v/autopilot/state"
        sample = self.world.sensors[path].sensor.measure(None)  # type: ignore[arg-type]
        return dict(zip((f.name for f in self.world.ports[path].fields), sample[1], strict=True))

    @property
    def heading(self) -> float:
        """Yaw, rad."""
        return float(self.vehicle.pose.rpy[2])

    def off_heading(self, wanted: float) -> float:
        """Degrees."""
        return abs(math.degrees(math.remainder(self.heading - wanted, 2 * math.pi)))

    def refusal(self, port: str, **value: Any) -> str:
        """What a command to a port of the vehicle is answered; "" when it is taken."""
        from uwserver.ports.checks import checked_command

        answers: list[Reply] = []
        path = f"v/{port}"
        self.world.submit(Command(path, checked_command(self.world.ports[path], value), "test"), answers.append)
        for on_reply, reply in self.world.flush().replies:
            on_reply(reply)
        return answers[0].fault.text if answers[0].fault else ""


def flight(model: str, *, start: tuple[float, float, float] = (0.0, 0.0, 3.0), yaw_deg: float = 0.0,
           current: tuple[float, float, float] = (0.0, 0.0, 0.0), speed: float = 0.0, bottom: float | None = 30.0,
           without: tuple[str, ...] = (), autopilot: dict[str, Any] | None = None, seed: int = 3,
           origin: bool = False, terrain: Path | None = None, override: dict[str, Any] | None = None) -> Flight:  # fmt: skip
    """A vehicle with AHRS, depth sensor and, over a bottom, DVL; 0.5 s old, so that its sensors have spoken. `terrain`: depths (m) instead of a
    level bottom, 2 m apart, about the origin."""
    builder = ScenarioBuilder("flight", seed=seed, rate_hz=RATE, adapters={})
    if origin:
        builder.world(origin_lat_deg=63.0, origin_lon_deg=10.0)
    builder.current(velocity_ned_mps=current)
    config = {"start_position_ned_m": start, **(autopilot or {})}
    builder.vehicle("v", model, position_ned_m=start, attitude_rpy_deg=[0, 0, yaw_deg], velocity_frd_mps=[speed, 0, 0],
                    autopilot=config, override=override or {})  # fmt: skip
    if "ahrs" not in without:
        builder.sensor("v", "ahrs", "attitude", rate_hz=40, noise_deg=0.05, tilt_sigma_deg=0.3, heading_sigma_deg=0.3)
    if bottom is not None:
        if terrain is None:
            builder.seabed("flat", depth_m=bottom)
        else:
            builder.seabed("grid", file=str(terrain), spacing_m=[2.0, 2.0])
        if "dvl" not in without:
            builder.sensor("v", "dvl", "dvl", rate_hz=8, processing_s=0.05)
        if "altimeter" not in without:
            builder.sensor("v", "altimeter", "altimeter", rate_hz=10)
    builder.sensor("v", "leak", "leak", rate_hz=4)
    built = Flight(build(read_once(builder.build())))
    built.run(0.5)
    return built


@pytest.fixture
def fly():
    """Builds a flight."""
    return flight


@pytest.fixture
def flying():
    """Short words for a world with one vehicle `v`."""
    return Flight
