"""Free-running worlds compared with other engines, in one process. Each repeat runs every contender once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import WorldTable
from uwserver.simulation.clock import SystemTime
from uwserver.world.world import World
from uwserver_bench.engine.peers import BulletBodies, BulletWithNumpy, MujocoFluid, MujocoVehicle
from uwserver_bench.report import Row

RATE_HZ = 240.0
DEPTH_M = 100.0
"""Deep enough that no vehicle drifts to the surface within a repeat."""

COMMAND_EVERY = 24
"""Number of ticks between two thruster commands of a vehicle (10 Hz). The vehicles take turns."""

COUNTS = (1, 10, 100)
BARS: Mapping[int, float] = {1: 200.0, 10: 80.0, 100: 10.0}
SENSORS_BAR = 100.0

_PEERS: tuple[tuple[type[BulletBodies | MujocoFluid], str], ...] = (
    (BulletBodies, "pybullet"),
    (BulletWithNumpy, "pybullet"),
    (MujocoFluid, "mujoco"),
    (MujocoVehicle, "mujoco"),
)


class Contender(Protocol):
    """Something that steps vehicles; `dt` is its step, s."""

    name: str
    vehicles: int
    dt: float

    def prepare(self) -> None:
        """Reset to the start. This is not timed."""

    def run(self, steps: int) -> None:
        """Make the steps."""

    def close(self) -> None:
        """Free its resources."""


class OpenWater:
    """BlueROV2 Heavies stepped by `World.advance`, as in the server: kernel, thrusters, watchdogs, and commands that change at 10 Hz.

    Args:
        vehicles: number of vehicles.
        sensors: whether they have the sensors of the vehicle file, with their rates and errors.
        threads: number of threads of the world.
    """

    dt = 1.0 / RATE_HZ

    def __init__(self, vehicles: int, sensors: bool = False, threads: int | Literal["auto"] = "auto") -> None:
        self.name = "uwserver, physics + thrusters + sensors" if sensors else "uwserver, physics + thrusters"
        self.vehicles = vehicles
        entries = {
            f"rov{k}": VehicleEntry(model="bluerov2_heavy", position_ned_m=(5.0 * (k % 10), 5.0 * (k // 10), DEPTH_M))
            for k in range(vehicles)
        }
        scenario = Scenario(schema=1, seed=1, world=WorldTable(rate_hz=RATE_HZ, threads=threads), vehicles=entries)
        self._world = build(load(scenario, adapters={}))
        self._sensors = sensors
        self._ports = [f"{name}/thrusters" for name in entries]
        # Zero on average, so that no vehicle goes far.
        (size,) = self._world.ports[self._ports[0]].fields[0].shape
        draws = np.random.Generator(np.random.PCG64(1)).uniform(-0.5, 0.5, (64, size))
        self._commands = [[*row.tolist()] for row in np.concatenate([draws, -draws])]
        self._tick = 0

    def prepare(self) -> None:
        """Reset the world to its start, with commands for all vehicles."""
        self._world.call("world/reset")
        self._tick = 0
        if not self._sensors:
            for path in self._world.sensors:
                self._world.call(f"{path}/deactivate")
        for k, port in enumerate(self._ports):
            self._world.command(port, u=self._commands[k % len(self._commands)])
        self._world.step(2)

    def run(self, steps: int) -> None:
        """Make ticks with their commands. Samples are made and dropped."""
        world, ports, commands = self._world, self._ports, self._commands
        begin, self._tick = self._tick, self._tick + steps
        for tick in range(begin, self._tick):
            for k in range(tick % COMMAND_EVERY, len(ports), COMMAND_EVERY):
                world.command(ports[k], u=commands[(tick // COMMAND_EVERY + k) % len(commands)])
            world.advance()

    @property
    def world(self) -> World:
        """The world that it steps."""
        return self._world

    @property
    def hydro(self) -> Hydrodynamics:
        """The bodies of the world."""
        return self._world.hydro

    def close(self) -> None:
        """Do nothing: there is nothing to free."""


@dataclass(frozen=True)
class Timing:
    """Time of a step of one contender, s, one value for each repeat."""

    name: str
    vehicles: int
    dt: float
    seconds: tuple[float, ...]

    @property
    def real_time_factors(self) -> tuple[float, ...]:
        """Simulated seconds per second, one value for each repeat."""
        return tuple(self.dt / s for s in self.seconds)


def bench_physics(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on physics.

    Args:
        quick: two short repeats.
        say: gets a line of progress.
    """
    repeats, budget_s = (2, 0.02) if quick else (7, 0.4)
    missing: dict[str, str] = {}
    with ExitStack() as stack:
        contenders: list[Contender] = [OpenWater(1), OpenWater(1, sensors=True), OpenWater(10), OpenWater(100)]
        for kind, package in _PEERS:
            try:
                contenders += [kind(n) for n in COUNTS]
            except ImportError as error:
                missing[package] = f"not installed: pip install {package} ({error})"
        for contender in contenders:
            stack.callback(contender.close)
        timings = _interleaved(contenders, repeats, budget_s, say)
    return [*_own_rows(timings), *_peer_rows(timings, missing), *_ratio_rows(timings)]


def _interleaved(
    contenders: Sequence[Contender], repeats: int, budget_s: float, say: Callable[[str], None]
) -> list[Timing]:
    say("physics: compiling and warming up")
    steps = [_steps_in(contender, budget_s) for contender in contenders]
    seconds: list[list[float]] = [[] for _ in contenders]
    for repeat in range(repeats):
        say(f"physics: repeat {repeat + 1} of {repeats}")
        for contender, n, taken in zip(contenders, steps, seconds, strict=True):
            taken.append(_seconds_a_step(contender, n))
    return [Timing(c.name, c.vehicles, c.dt, tuple(s)) for c, s in zip(contenders, seconds, strict=True)]


def _seconds_a_step(contender: Contender, steps: int) -> float:
    clock = SystemTime()
    contender.prepare()
    start = clock.now_ns()
    contender.run(steps)
    return (clock.now_ns() - start) * 1e-9 / steps


def _steps_in(contender: Contender, budget_s: float) -> int:
    """Return the number of steps that fill the budget. The first steps, which may compile, are not counted."""
    contender.prepare()
    contender.run(5)
    return max(5, round(budget_s / _seconds_a_step(contender, 20)))


def _row(timing: Timing, bar: float | None = None, note: str = "") -> Row:
    return Row("physics", _title(timing.name, timing.vehicles), "x realtime", timing.real_time_factors, bar, note=note)


def _title(name: str, vehicles: int) -> str:
    return f"{name}: {vehicles} vehicle{'s' if vehicles > 1 else ''}"


def _own_rows(timings: Sequence[Timing]) -> list[Row]:
    rows = []
    for timing in timings:
        if timing.name == "uwserver, physics + thrusters":
            rows.append(_row(timing, BARS[timing.vehicles]))
        elif timing.name.startswith("uwserver"):
            rows.append(_row(timing, SENSORS_BAR))
    return rows


def _peer_rows(timings: Sequence[Timing], missing: Mapping[str, str]) -> list[Row]:
    rows = []
    for kind, package in _PEERS:
        name = kind.name
        found = [_row(timing) for timing in timings if timing.name == name]
        rows += found or [Row("physics", name, "x realtime", (), note=missing[package])]
    return rows


def _ratio_rows(timings: Sequence[Timing]) -> list[Row]:
    """Return for each repeat the time of a vehicle-step of each peer over ours: above 1 we are faster."""
    own = {t.vehicles: t for t in timings if t.name == "uwserver, physics + thrusters"}
    rows = []
    for peer in timings:
        if peer.name.startswith("uwserver"):
            continue
        values = tuple(theirs / ours for theirs, ours in zip(peer.seconds, own[peer.vehicles].seconds, strict=True))
        bar = 1.0 if peer.name == MujocoVehicle.name and peer.vehicles == 100 else None
        rows.append(Row("physics", f"a step of {_title(peer.name, peer.vehicles)} / ours", "ratio", values, bar))
    return rows
