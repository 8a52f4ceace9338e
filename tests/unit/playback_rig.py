"""Short recordings, made without threads of a loop, and players that a test turns by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.ports import Call, Command, Event, Progress, Reply, Sample
from uwserver.ports.crossing import TickOutput
from uwserver.recording.parts import ONE_FILE, Rotation
from uwserver.recording.player.player import Player
from uwserver.recording.player.track import Track
from uwserver.recording.player.world import Range
from uwserver.recording.recorder import Recorder
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime, Timing
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation
from uwserver.testing.mock_time import MockTime
from uwserver.world.state.scene_probe import SceneProbe


@cache
def pool() -> Resolved:
    vehicle = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 1.0))
    return load(Scenario(schema=1, title="test", seed=3, vehicles={"rov": vehicle}), adapters={})


class Dive:
    """Records a world tick by tick.

    Attributes:
        samples: that were recorded, those of each run between resets in a list of their own.
        events: that were recorded.
        poses: of the rov, by run and time.
    """

    def __init__(self, path: Path, resolved: Resolved, lag: int = 0, rotation: Rotation = ONE_FILE) -> None:
        self._late: list[TickOutput] = []
        self._lag = lag
        self.world = build(resolved)
        self.bus = Bus(lambda function: None)
        self.simulation = Simulation(self.world, Timing("freerun"), SystemTime(), self.bus, Mailbox())
        self.recorder = Recorder(path, self.world, resolved, rotation)
        self.samples: list[list[Sample]] = [[]]
        self.poses: dict[tuple[int, int], Any] = {}
        self.events: list[Event] = []
        self._batch = 0
        self._probe = SceneProbe(self.world)
        self._recording = self.recorder.running(self.simulation, self.bus)

    def __enter__(self) -> Dive:
        self._recording.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        while self._late:
            self._hear(self._late.pop(0))
        self._recording.__exit__(*error)

    def go(self, ticks: int) -> None:
        for _ in range(ticks):
            output = self.world.advance()
            self.recorder.ticked(self.world)
            self._take(output)
            self.poses[len(self.samples) - 1, self.world.t_ns] = np.array(self._probe.state().poses)

    def push(self, force: float) -> None:
        self._request(Command("rov/thrusters", ((force,) * 8,), "tester"))
        self.world.submit(Command("rov/thrusters", ((force,) * 8,), "tester"))

    def call(self, service: str, **args: Any) -> None:
        self._request(Call(service, args, "tester"))
        self.world.call(service, **args)
        self._take(self.world.flush())

    def _request(self, item: Command | Call) -> None:
        self._batch += 1
        self.recorder.requested(item, self.world.tick, self._batch)

    def _take(self, output: TickOutput) -> None:
        self.events += output.events
        for event in output.events:
            if event.event == "reset":
                self.samples.append([])
        self.samples[-1] += output.samples
        self._late.append(output)
        if len(self._late) > self._lag:
            self._hear(self._late.pop(0))

    def _hear(self, output: TickOutput) -> None:
        for event in output.events:
            self.recorder.put_event(event)
        self.recorder.put_samples(output.samples)


def recorded(
    path: Path,
    ticks: int = 480,
    script: Callable[[Dive], None] | None = None,
    lag: int = 0,
    rotation: Rotation = ONE_FILE,
) -> Dive:
    """A dive of two seconds, or what the script says; the loop has samples so many ticks late, as of a world that nothing paces."""
    with Dive(path, pool(), lag, rotation) as dive:
        if script is None:
            dive.push(0.4)
            dive.go(ticks)
        else:
            script(dive)
    return dive


class Deck:
    """A player that the test turns, and all that it says."""

    def __init__(self, path: Path, timing: Timing = Timing("freerun"), span: Range = Range(), **more: Any) -> None:  # noqa: B008  # immutable
        self._calls: list[Callable[[], None]] = []
        self.samples: list[Sample] = []
        self.events: list[Event] = []
        self.bus = Bus(self._calls.append)
        self.mailbox = Mailbox()
        self.time = MockTime()
        self.track = Track(path, **more)
        self.player = Player(self.track, timing, span, self.time, self.bus, self.mailbox)
        self.bus.attach(self)

    def put_samples(self, samples: Sequence[Sample]) -> None:
        self.samples += samples

    def put_event(self, event: Event) -> None:
        self.events.append(event)

    def turn(self, times: int = 1) -> None:
        for _ in range(times):
            self.player._turn()
            self.hear()

    def hear(self) -> None:
        while self._calls:
            self._calls.pop(0)()
        self.bus.drain()

    def play(self) -> None:
        """Until it pauses."""
        for _ in range(100_000):
            if self.player.paused:
                return
            self.turn()
        raise AssertionError("it never ends")

    def call(self, service: str, **args: Any) -> Reply:
        from uwserver.ports.checks import checked_args
        from uwserver.recording.player.world import SERVICES

        answers: list[Reply | Progress] = []
        self.player.call(service, checked_args(SERVICES[service], args), "", answers.append)
        for _ in range(1000):
            self.turn()
            if answers and isinstance(answers[-1], Reply):
                return answers[-1]
        raise AssertionError(f"no answer to {service}")

    def close(self) -> None:
        self.track.close()
