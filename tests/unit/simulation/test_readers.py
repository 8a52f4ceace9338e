"""Samples are made of what somebody reads, and of nothing else: counted, not timed."""

from __future__ import annotations

import queue
import threading
from collections.abc import Collection, Iterator

import pytest
from simulation_rig import PATIENCE_S, Rig, running

from uwserver.ports import Call, Sample, SceneState, sample_batch
from uwserver.ports.checks import checked_args
from uwserver.ports.crossing import TickOutput
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.simulation import readers as module
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Timing
from uwserver.world.sensing import sensing
from uwserver.world.state.scene_probe import SceneProbe

TICKS = 48


class Reader:
    """A sink that says what it wants."""

    def __init__(self, *paths: str) -> None:
        self.subscriptions: Collection[str] | None = paths
        self.samples: list[Sample] = []
        self.events: list[str] = []
        self.seen: list[str] = []

    def put_samples(self, samples: list[Sample]) -> None:
        self.samples += [
            sample for sample in samples if self.subscriptions is None or sample.port in self.subscriptions
        ]
        self.seen += [sample.port for sample in samples]

    def put_event(self, event) -> None:
        self.events.append(event.event)
        self.seen.append(event.event)


@pytest.fixture
def still(resolved: Resolved, made: list[str]) -> Iterator[Rig]:
    """A paused world which the rig itself does not read."""
    with running(resolved, Timing(paused=True)) as rig:
        rig.subscriptions = ()
        rig.bus.subscriptions_changed()
        yield rig


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Ports of all samples that the world gave."""
    ports: list[str] = []
    publish = Bus.publish

    def counted(bus: Bus, output: TickOutput, wake: bool = True) -> None:
        ports.extend(() if output.batch is None else output.batch.ports)
        ports.extend(sample.port for sample in output.made)
        publish(bus, output, wake)

    monkeypatch.setattr(Bus, "publish", counted)
    return ports


def step(rig: Rig, n: int = TICKS) -> None:
    rig.call("world/step", n=n)
    rig.call("world/step", n=1)  # its answer comes behind all samples of the ticks before


def expected(resolved: Resolved, ticks: int) -> list[Sample]:
    """What a world gives whose samples are all read."""
    return build(resolved).step(ticks)


def test_who_reads_nothing_costs_nothing(still: Rig, made: list[str]):
    step(still)
    assert made == []
    assert still.samples == []
    assert still.bus.last == {}


def test_who_comes_later_gets_what_he_would_have_got_all_along(still: Rig, resolved: Resolved, made: list[str]):
    step(still)
    reader = Reader("rov/depth")
    still.bus.attach(reader)
    still.call("world/step", n=TICKS)
    step(still, 1)
    assert set(made) == {"rov/depth"}
    begin = still.world.ticks.time_of(TICKS + 1)
    later = [s for s in expected(resolved, 2 * TICKS + 2) if s.port == "rov/depth" and s.t_sent_ns > begin]
    assert reader.samples == later
    assert later[0].seq > 0


def test_a_step_that_is_asked_for_after_a_want_gives_its_samples(still: Rig):
    reader = Reader()
    still.bus.attach(reader)
    for path in ("rov/depth", "rov/imu", "rov/depth"):
        reader.subscriptions = (path,)
        still.bus.subscriptions_changed()
        reader.samples.clear()
        step(still)
        assert {s.port for s in reader.samples} == {path}
        assert reader.samples[-1].seq - reader.samples[0].seq == len(reader.samples) - 1


def test_two_readers_and_one_of_them_leaves(still: Rig, made: list[str]):
    one, two = Reader("rov/depth", "rov/imu"), Reader("rov/imu")
    leave, _ = still.bus.attach(one), still.bus.attach(two)
    step(still)
    assert set(made) == {"rov/depth", "rov/imu"}
    assert made.count("rov/imu") == len(two.samples), "made once for both"
    assert [s for s in one.samples if s.port == "rov/imu"] == two.samples
    leave()
    made.clear()
    step(still)
    assert set(made) == {"rov/imu"}
    assert set(still.bus.last) == {"rov/imu"}


def test_who_does_not_say_what_it_wants_gets_all(still: Rig, resolved: Resolved, made: list[str]):
    reader = Reader()
    reader.subscriptions = None
    leave = still.bus.attach(reader)
    step(still)
    assert len(made) == len(reader.samples)
    assert reader.samples == expected(resolved, TICKS + 1)[: len(reader.samples)]
    leave()
    made.clear()
    step(still)
    assert made == []


class Later(Reader):
    """Reads a port as soon as it has heard that it is there."""

    def __init__(self, bus: Bus, path: str) -> None:
        super().__init__()
        self.bus, self.path = bus, path

    def put_event(self, event) -> None:
        super().put_event(event)
        if event.event == "ports_changed":
            self.subscriptions = {self.path} & self.bus.ports.keys()


def test_nothing_is_lost_of_a_vehicle_that_comes_later(resolved: Resolved, made: list[str]):
    """Its first samples are made although nobody could name them before anybody has heard of it; then those that are named."""
    gate = threading.Event()
    with running(resolved) as rig:
        rig.subscriptions = ()
        rig.bus.subscriptions_changed()
        reader = Later(rig.bus, "new/imu")
        rig.bus.attach(reader)
        rig.bus._wake_loop(lambda: gate.wait(PATIENCE_S))  # the loop is slow: the world goes on meanwhile
        args = {"name": "new", "like": "rov", "p_NB": [9.0, 9.0, 5.0]}
        rig.mailbox.post(Call("world/spawn", checked_args(rig.world.services["world/spawn"], args)), None)
        while "new" not in rig.world.vehicles:
            gate.wait(0.001)
        tick = rig.world.tick
        while rig.world.tick < tick + TICKS and rig.bus.backlog() < 2:
            gate.wait(0.001)
        gate.set()
        rig.call("world/pause")
        made.clear()
        step(rig)
        assert set(made) == {"new/imu"}
        assert reader.seen[0] == "ports_changed"
        assert [sample.seq for sample in reader.samples] == list(range(len(reader.samples)))


def test_the_newest_of_what_nobody_wants_can_be_read(still: Rig, resolved: Resolved, monkeypatch):
    objects: list[str] = []

    def counted(port: str, *parts) -> Sample:
        objects.append(port)
        return Sample(port, *parts)

    for maker in (sample_batch, sensing):
        monkeypatch.setattr(maker, "Sample", counted)
    monkeypatch.setattr(module, "AT_ONCE", 2)
    still.call("world/step", n=TICKS)
    told: list = []
    paths = ["rov/depth", "gone/imu", *(path for path, port in still.world.ports.items() if port.direction == "sensor")]
    still.simulation.readers.read(paths, told.append, "robots:1")
    still.call("world/pause")
    still.call("world/pause")
    assert len(told) == 1
    assert len(objects) == len(told[0])
    newest = {sample.port: sample for sample in expected(resolved, TICKS)}
    assert {sample.port: sample for sample in told[0]} == newest
    assert len(told[0]) == len(newest) + 1, "one was asked for twice, and one is not there"


def test_a_read_is_answered_behind_what_was_said_before(still: Rig):
    order: list[int] = []
    reader = Reader("rov/imu")
    reader.put_samples = lambda samples: order.extend(sample.seq for sample in samples)
    still.bus.attach(reader)
    still.call("world/step", n=TICKS)
    still.simulation.readers.read(["rov/imu"], lambda samples: order.extend(100 + s.seq for s in samples))
    still.call("world/pause")
    assert order == [*range(order[-2] + 1), 100 + order[-2]]


def test_who_still_waits_for_a_reading_at_the_end_gets_it(resolved: Resolved):
    told: list = []
    with running(resolved, Timing(paused=True)) as rig:
        rig.call("world/step", n=TICKS)

        def end() -> None:
            rig.simulation.stop()
            rig.simulation.readers.read(["rov/imu", "rov/depth"], told.append)

        rig.simulation.steer(end)
    assert [[sample.port for sample in samples] for samples in told] == [["rov/imu", "rov/depth"]]


def test_a_driver_is_no_sink_and_is_a_reader(still: Rig, made: list[str]):
    forget = still.bus.add_reader(Reader("rov/depth"))
    step(still)
    assert set(made) == {"rov/depth"}
    forget()
    made.clear()
    step(still)
    assert made == []


def test_a_fault_in_what_viewers_see_ends_no_world(
    still: Rig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fails(self: SceneProbe) -> None:
        raise KeyError("object")

    seen: queue.Queue[SceneState] = queue.Queue()
    monkeypatch.setattr(SceneProbe, "state", fails)
    for _ in range(3):
        still.simulation.readers.request_scene_state(seen.put, "viewer")
        assert seen.get(timeout=PATIENCE_S).entities.vehicles == ()
    monkeypatch.undo()
    still.simulation.readers.request_scene_state(seen.put, "viewer")
    assert seen.get(timeout=PATIENCE_S).entities.vehicles
    step(still)
    assert caplog.text.count("Traceback") == 1
