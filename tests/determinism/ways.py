"""The ways in which a story can be run. Each gives its trace; all must be equal."""

from __future__ import annotations

import contextlib
import itertools
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from unittest.mock import patch

import msgspec
from mcap.reader import make_reader
from stories import Act, Story
from traces import Trace

from uwserver.adapter import installed_adapters
from uwserver.ports import Call, Command, Event, Progress, Refused, Reply, Sample
from uwserver.recording.recorder import Recorder
from uwserver.recording.replay import Replayed, replay
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.simulation import intake
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime, Timing
from uwserver.simulation.intake import Observer
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation
from uwserver.units import NANOSECONDS
from uwserver.world import World
from uwserver.world.state import snapshot

PATIENCE_S = 600.0
ODD = (1, 7, 2, 31, 5, 13, 1, 64, 3)
"""Ticks of one step, again and again."""


def resolved(scenario: str) -> Resolved:
    """A scenario; its adapters are not started here."""
    return load(scenario, adapters=installed_adapters())


# -- in this process -------------------------------------------------------------------------------------------------------------------


def post(story: Story, step: int, world: World, trace: Trace, source: str = "in-process") -> None:
    """What is asked before a tick."""
    for name, act in story.numbered(step):
        try:
            world.submit(act.item(world, source), trace.replied(name))
        except Refused as refused:
            trace.refused(name, refused.fault.text)


def play(story: Story, world: World, trace: Trace, first: int = 0, end: int | None = None) -> Trace:
    """Run a part of a story in a world that stands where the part begins."""
    for step in range(first, story.steps if end is None else end):
        post(story, step, world, trace)
        output = world.advance()
        for on_reply, reply in output.replies:
            on_reply(reply)
        trace.take(output.samples)
        trace.stand(step + 1, story.steps, world)
    return trace


def in_process(story: Story) -> Trace:
    """Tick by tick, without a thread: what all others are compared with."""
    return play(story, build(resolved(story.scenario)), Trace()).end()


def after_a_reset(story: Story) -> Trace:
    """The whole story after a reset amid its first half."""
    world = build(resolved(story.scenario))
    play(story, world, Trace(), end=story.steps // 2)
    world.call("world/reset")
    for on_reply, reply in world.flush().replies:
        on_reply(reply)
    return play(story, world, Trace()).end()


def there_and_back(story: Story) -> Trace:
    """Saved as bytes now and then; what the world does next is undone, in the same world or by a new one that goes on from the bytes."""
    world, trace = build(resolved(story.scenario)), Trace()
    saves = sorted({story.first_jump - 1, *range(60, story.steps, max(157, story.steps // 8))})
    for begin, end in itertools.pairwise([0, *saves, story.steps]):
        play(story, world, trace, begin, end)
        saved = snapshot.to_bytes(world, snapshot.take(world))
        play(story, world, Trace(), end, min(end + 50, story.first_jump - 1, story.steps))
        world.set_current((0.5, 0.5, 0.1))
        world.step(5)
        if end < story.first_jump:  # a new world knows no snapshot that was kept under a name
            world = build(resolved(story.scenario))
        snapshot.from_bytes(world, saved)
        world.flush()
    return trace.end()


def other_process(stories: Sequence[Story]) -> dict[str, Trace]:
    """Tick by tick in a new interpreter, in which texts have other hashes."""
    paths = [path for path in sys.path if path]
    code = (
        f"import sys; sys.path[:0] = {[str(Path(__file__).parent), *paths]!r}\n"
        "import msgspec, stories, ways\n"
        "for told in msgspec.json.decode(sys.stdin.buffer.read(), type=list[stories.Story]):\n"
        "    print(told.scenario, ways.in_process(told).as_json().decode())\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], input=msgspec.json.encode(stories), capture_output=True, timeout=PATIENCE_S
    )
    assert answer.returncode == 0, answer.stderr.decode()
    lines = (line.split(b" ", 1) for line in answer.stdout.splitlines())
    return {name.decode(): Trace.from_json(data) for name, data in lines}


# -- by the simulation thread ----------------------------------------------------------------------------------------------------------


class Stage:
    """A simulation in its thread, with the test as its loop. Also its observer, and a sink of its samples.

    Attributes:
        driven: the acts are posted between two ticks of the running world; else whoever steps it posts them.
        recorder: follows the run too.
    """

    def __init__(self, story: Story, timing: Timing, driven: bool, source: str) -> None:
        self.resolved = resolved(story.scenario)
        self.world = build(self.resolved)
        self.driven = driven
        self.recorder: Observer | None = None
        self.trace = Trace()
        self.bus, self.mailbox = Bus(self._put), Mailbox()
        self.simulation = Simulation(self.world, timing, SystemTime(), self.bus, self.mailbox)
        self.step = 0
        self._story, self._source = story, source
        self._calls: queue.Queue[Callable[[], None]] = queue.Queue()
        self._over = False
        self._waiting: set[str] = set()

    def _put(self, call: Callable[[], None]) -> None:
        self._calls.put(call)

    # sink, on the loop

    def put_samples(self, samples: Sequence[Sample]) -> None:
        self.trace.take(samples)

    def put_event(self, event: Event) -> None:
        pass

    # observer, on the simulation thread

    def requested(self, item: Command | Call, tick: int, batch: int) -> None:
        if self.recorder is not None:
            self.recorder.requested(item, tick, batch)

    def ticked(self, world: World) -> None:
        if self.recorder is not None:
            self.recorder.ticked(world)
        self.step += 1
        self.trace.stand(self.step, self._story.steps, world)
        if self.driven and self.step < self._story.steps:
            self.ask(self.step)
        elif self.driven:
            self.simulation.call("world/pause", {}, "", self._is_over)

    def next_tick(self, tick: int) -> int:
        return tick + 1

    def _is_over(self, answer: Reply | Progress) -> None:
        self._over = True

    # the test

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        self.bus.attach(self)
        self.simulation.observe(self)
        thread = threading.Thread(target=self.simulation.run, daemon=True)
        if self.driven:
            self.ask(0)
        thread.start()
        try:
            yield
        finally:
            self.simulation.stop()
            thread.join(PATIENCE_S)
            self.bus.drain()

    def pump(self, done: Callable[[], object]) -> None:
        while not done():
            self._calls.get(timeout=PATIENCE_S)()

    def ask(self, step: int) -> list[Act]:
        """Post what is asked before a tick; gives what was posted."""
        posted = []
        for name, act in self._story.numbered(step):
            try:
                item = act.item(self.world, self._source)
            except Refused as refused:
                self.trace.refused(name, refused.fault.text)
                continue
            is_long = not act.is_command and self.world.services[act.path].long_running
            if not is_long:
                self._waiting.add(name)
            self.mailbox.post(item, self._heard(name))
            posted.append(act)
        return posted

    def _heard(self, name: str) -> Callable[[Reply | Progress], None]:
        note = self.trace.replied(name)

        def heard(answer: Reply | Progress) -> None:
            note(answer)
            if isinstance(answer, Reply):
                self._waiting.discard(name)

        return heard

    def ask_and_wait(self, step: int) -> None:
        """The same, until all of it is done."""
        self.ask(step)
        self.pump(lambda: not self._waiting)

    def advance(self, n: int, client: str = "") -> None:
        """Let a client step n ticks, and wait for them."""
        answers: list[Reply] = []
        self.simulation.call("world/step", {"n": n}, client, _finals(answers))
        self.pump(lambda: answers)
        assert answers[0].fault is None, answers[0].fault

    def advance_all(self, client: str = "", before: Callable[[int], object] | None = None) -> None:
        """The whole story by steps of odd numbers of ticks."""
        sizes = itertools.cycle(ODD)
        step = 0
        while step < self._story.steps:
            (before or self.ask_and_wait)(step)
            end = self._story.next_after(step)
            while step < end:
                n = min(next(sizes), end - step)
                self.advance(n, client)
                step += n

    def grant_always(self, client: str, n: int) -> None:
        """Let another client grant n ticks again and again; also after a jump, which ends what it had granted."""

        def again(answer: Reply | Progress) -> None:
            if isinstance(answer, Reply) and (answer.fault is None or answer.fault.code == "preempted"):
                self.simulation.call("world/step", {"n": n}, client, again)

        self.simulation.call("world/step", {"n": n}, client, again)

    def end(self) -> Trace:
        assert self.bus.dropped == 0
        assert self.step == self._story.steps
        return self.trace.end()


def _finals(answers: list[Reply]) -> Callable[[Reply | Progress], None]:
    return lambda answer: answers.append(answer) if isinstance(answer, Reply) else None


def _driven(story: Story, timing: Timing, source: str) -> Trace:
    stage = Stage(story, timing, True, source)
    with stage.running():
        stage.pump(lambda: stage._over)
    return stage.end()


def free_run(story: Story) -> Trace:
    """As fast as it goes."""
    return _driven(story, Timing("freerun"), "free")


def real_time(speed: float) -> Callable[[Story], Trace]:
    """By the wall clock, and behind it where the machine is too slow."""

    def run(story: Story) -> Trace:
        # What of one tick does not fit into its budget goes to the next, as it should: not what is tried here.
        with patch.object(intake, "REQUESTS_NS", NANOSECONDS):
            return _driven(story, Timing("realtime", speed=speed), f"fast {speed}")

    return run


def paused(story: Story) -> Trace:
    """Steps of odd numbers of ticks; what is asked meets the world in the first tick of a step, or before it."""
    stage = Stage(story, Timing("freerun", paused=True), False, "stepper")

    def before(step: int) -> None:
        if any(act.is_jump for act in stage.ask(step)):
            stage.pump(lambda: not stage._waiting)  # a jump ends the steps that were asked

    with stage.running():
        stage.advance_all(before=before)
    return stage.end()


def lockstep_one(story: Story) -> Trace:
    """One client in the barrier."""
    stage = Stage(story, Timing("lockstep", lockstep_clients=("a",)), False, "a")
    with stage.running():
        stage.advance_all("a")
    return stage.end()


def lockstep_two(story: Story) -> Trace:
    """Two clients in the barrier, with steps of different lengths; one of them asks for everything."""
    stage = Stage(story, Timing("lockstep", lockstep_clients=("a", "b")), False, "a")
    with stage.running():
        stage.grant_always("b", 11)
        stage.advance_all("a")
    return stage.end()


def recorded(story: Story, path: Path) -> Trace:
    """In free-run with a recorder."""
    stage = Stage(story, Timing("freerun"), True, "recorded")
    recorder = Recorder(path, stage.world, stage.resolved)
    with recorder.running(stage.simulation, stage.bus):
        stage.recorder = recorder
        with stage.running():
            stage.pump(lambda: stage._over)
    status = recorder.status()
    assert (status["error"], status["dropped"], status["samples"]) == ("", 0, stage.trace.count)
    return stage.end()


def recording(path: Path, run: Trace) -> Trace:
    """The states and replies of a run, with the samples in its file."""
    trace = Trace()
    trace.states, trace.replies = run.states, run.replies
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.message_encoding != "json":
                continue  # for viewers and players
            body = msgspec.json.decode(message.data)
            if isinstance(body, dict) and "t_sent_ns" in body:
                values = tuple(body["value"].values())
                trace.take_one(channel.topic, body["seq"], body["t_ns"], body["t_sent_ns"], body["valid"], values)
    return trace.end()


def replayed(path: Path) -> Replayed:
    """A recording, run again without a difference."""
    result = replay(path)
    assert result.difference is None, result.difference
    assert result.hashes > 0
    return result


WAYS: dict[str, Callable[[Story], Trace]] = {
    "paused": paused,
    "free-run": free_run,
    "real time x5": real_time(5.0),
    "real time x20": real_time(20.0),
    "lock-step, one client": lockstep_one,
    "lock-step, two clients": lockstep_two,
    "there and back": there_and_back,
    "after a reset": after_a_reset,
}
SILENT = ("there and back",)
"""Ways in which some who wait for a reply get another: that the world left the time in which they asked."""
