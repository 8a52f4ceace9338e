"""What is carried out in which tick: within a budget in real time, all of it elsewhere; and what the observer is told of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest

from uwserver.ports import Call, Command, Json, Reply, Service
from uwserver.ports.checks import checked_args
from uwserver.scenario.build.world import build
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Timing
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation
from uwserver.testing import MockTime
from uwserver.world.state import snapshot
from uwserver.world.world import World

REALTIME = Timing()
COSTS_S = 0.0004
"""Of one call of test/cost: the third uses up the budget of a millisecond."""


class Bench:
    """A simulation whose wall time passes only when a request costs some; the test is its loop and its thread."""

    def __init__(self, resolved, timing: Timing = REALTIME) -> None:
        self.time = MockTime()
        self.world: World = build(resolved)
        self.mailbox, self.bus = Mailbox(), Bus(lambda _: None, self.time)
        self.simulation = Simulation(self.world, timing, self.time, self.bus, self.mailbox)
        self.simulation.observe(self)
        self.world.offer(Service("test/cost", "Takes its time."), self.cost)
        self.seen: list[tuple[int, int, str]] = []
        self.replies: list[tuple[str, int]] = []

    def cost(self, args: Mapping[str, Json]) -> Json:
        self.time.pass_time(COSTS_S)
        return None

    def requested(self, item: Command | Call, tick: int, batch: int) -> None:
        self.seen.append((tick, batch, item.source))

    def ticked(self, world: World) -> None:
        pass

    def next_tick(self, tick: int) -> int:
        return tick + 1

    def post(self, *sources: str, service: str = "test/cost") -> None:
        for source in sources:
            self.mailbox.post(Call(service, {}, source), self.noting(source))

    def noting(self, name: str) -> Callable[..., None]:
        def note(reply: Reply) -> None:
            assert reply.fault is None
            self.replies.append((name, reply.tick))

        return note

    def run(self, ticks: int) -> None:
        self.simulation.until_tick = self.world.tick + ticks
        self.simulation.run()
        self.bus.drain()


def test_in_real_time_a_tick_carries_out_what_fits_into_its_budget(resolved) -> None:
    bench = Bench(resolved)
    bench.post(*("a",) * 7)
    bench.run(4)
    assert bench.replies == [("a", 0)] * 3 + [("a", 1)] * 3 + [("a", 2)]
    assert [tick for tick, _, _ in bench.seen] == [0, 0, 0, 1, 1, 1, 2], "the observer knows the tick of each"


def test_a_lonely_request_is_not_kept_waiting_by_a_crowd_of_another(resolved) -> None:
    bench = Bench(resolved)
    bench.post(*("crowd",) * 100, "lonely 1", "lonely 2")
    bench.run(2)
    assert [reply for reply in bench.replies if reply[0] != "crowd"] == [("lonely 1", 0), ("lonely 2", 1)]


@pytest.mark.parametrize("mode", ["freerun", "lockstep"])
def test_without_a_wall_clock_all_is_carried_out_in_the_next_tick(resolved, mode) -> None:
    bench = Bench(resolved, Timing(mode))
    bench.post(*("a",) * 40, *("b",) * 3)
    bench.run(2)
    assert {tick for _, tick in bench.replies} == {0}
    assert [name for name, _ in bench.replies[:6]] == ["a", "b"] * 3
    assert {(tick, batch) for tick, batch, _ in bench.seen} == {(0, 0)}


def test_steps_of_a_paused_world_carry_out_all_of_it(resolved) -> None:
    bench = Bench(resolved, Timing(paused=True))
    bench.simulation.call("world/step", {"n": 2}, "", lambda _: None)
    bench.post(*("a",) * 40)
    bench.run(2)
    assert {tick for _, tick in bench.replies} == {0}


@pytest.mark.parametrize("service", ["world/reset", "world/restore"])
def test_a_tick_in_real_time_rebuilds_the_world_once_at_most(resolved, service) -> None:
    """Whoever asks: the others wait for the next tick."""
    bench = Bench(resolved)
    bench.world.call("world/snapshot", name="default")
    bench.run(3)
    for source in ("a", "b"):
        args: dict[str, Json] = {} if service == "world/reset" else {"name": "default"}
        for _ in range(2):
            bench.mailbox.post(Call(service, args, source), None)
    bench.post("c")
    jumps = []
    for _ in range(6):
        before = bench.world.jumps
        bench.simulation._tick()
        jumps.append(bench.world.jumps - before)
    assert jumps == [1, 1, 1, 1, 0, 0]
    assert [source for _, _, source in bench.seen] == ["a", "b", "c", "a", "b"]


def test_a_spawn_rebuilds_the_world_too_and_one_that_is_refused_does_not(resolved) -> None:
    bench = Bench(resolved)
    for name in ("a", "rov", "b"):  # there is a rov already
        args = checked_args(bench.world.services["world/spawn"], {"name": name, "like": "rov", "p_NB": [9.0, 0.0, 9.0]})
        bench.mailbox.post(Call("world/spawn", args, name), None)
    bench.run(2)
    assert [(tick, source) for tick, _, source in bench.seen] == [(0, "a"), (1, "rov"), (1, "b")]


def test_a_pause_does_not_wait_for_what_others_ask_of_the_clock_or_of_the_world(resolved) -> None:
    bench = Bench(resolved)
    simulation = bench.simulation
    bench.post(*("crowd",) * 500)
    for _ in range(500):
        simulation._steering.add(lambda: bench.time.pass_time(COSTS_S), "crowd")
    simulation.call("world/pause", {}, "", bench.noting("pause"), "me")
    simulation._turn()
    bench.bus.drain()
    assert bench.replies[0] == ("pause", 0)
    assert simulation.paused


def test_a_pause_does_not_wait_for_what_its_own_client_asked_of_the_clock(resolved) -> None:
    bench, faults = Bench(resolved), []
    for _ in range(50):
        bench.simulation.call("world/set_speed", {"speed": 2.0}, "", lambda reply: faults.append(reply.fault), "me")
    bench.simulation.call("world/resume", {}, "", lambda reply: faults.append(reply.fault), "me (name)")
    bench.simulation.call("world/pause", {}, "", bench.noting("pause"), "me (name)")
    for _ in range(3):
        bench.simulation._turn()
    bench.bus.drain()
    assert bench.simulation.paused, "what was asked before the pause must not end it"
    assert bench.replies == [("pause", 0)]
    assert [fault.code for fault in faults] == ["preempted"] * 51


@pytest.mark.parametrize("between", ["", "test/change"])
def test_the_state_is_hashed_once_a_tick_however_many_ask_unless_something_changed(
    resolved, monkeypatch, between
) -> None:
    bench, taken, hashes = Bench(resolved), [], []
    bench.world.offer(Service("test/change", "Moves it."), lambda _: bench.world.hydro.state.__setitem__((0, 0), 5.0))
    take = snapshot.take
    monkeypatch.setattr(snapshot, "take", lambda world: (taken.append(world.tick), take(world))[1])
    services = ["world/state_hash", "world/state_hash", "world/snapshot", between, "world/state_hash", "world/snapshot"]
    for service in filter(None, services):
        args: dict[str, Json] = {"name": "a"} if service == "world/snapshot" else {}
        bench.mailbox.post(Call(service, args, "me"), lambda reply: hashes.append(reply.result))
    bench.run(1)
    assert taken == [0] * (2 if between else 1)
    told = [result["hash"] for result in hashes if result]
    assert len(set(told)) == (2 if between else 1)
    assert told[0] == told[2]
    assert (told[-1] == told[0]) is not bool(between)
    bench.mailbox.post(Call("world/state_hash", {}, "me"), lambda reply: hashes.append(reply.result))
    bench.run(1)
    assert hashes[-1]["hash"] != told[-1], "another tick"


def test_whoever_has_his_hands_in_the_world_gets_the_hash_of_now(resolved) -> None:
    world = build(resolved)
    before = world.call("world/state_hash")
    world.hydro.state[0, 0] += 1.0
    moved = world.call("world/state_hash")
    assert moved["hash"] != before["hash"]
    world.step()
    assert world.call("world/state_hash")["hash"] != moved["hash"]


def test_what_the_clock_is_asked_has_a_budget_too_in_real_time(resolved) -> None:
    bench, done = Bench(resolved), []

    def action() -> None:
        done.append(bench.world.tick)
        bench.time.pass_time(0.0001)

    for _ in range(7):
        bench.simulation._steering.add(action, "crowd")
    bench.run(4)
    assert done == [0, 0, 0, 1, 1, 1, 2]


def test_the_ticks_that_were_told_give_the_same_state_again(resolved) -> None:
    """As a replay does it: the observer's order and ticks are all that there is to know."""
    bench, entries = Bench(resolved), []
    bench.requested = lambda item, tick, batch: entries.append((item, tick))  # type: ignore[method-assign]
    for n in range(60):
        bench.mailbox.post(Command("rov/thrusters", ((n / 60,) * 8,), f"pilot {n}" if n % 2 else "mate"), None)
        bench.post("crowd")
    bench.run(100)
    assert len({tick for _, tick in entries}) > 10
    again = build(resolved)
    again.offer(Service("test/cost", "Costs nothing here."), lambda _: None)
    for tick in range(100):
        for item, at in entries:
            if at == tick:
                again.submit(item)
        again.step(1)
    assert snapshot.take(again).hash() == snapshot.take(bench.world).hash()


@pytest.mark.parametrize("timing", [REALTIME, Timing("freerun"), Timing("freerun", paused=True)])
def test_who_ends_the_run_waits_for_one_request_only(resolved, timing: Timing) -> None:
    """The rest is refused, and no observer believes that it was carried out."""
    bench = Bench(resolved, timing)
    refused: list[str] = []

    def end(args: Mapping[str, Json]) -> Json:
        bench.simulation.stop()
        return None

    bench.world.offer(Service("test/end", "As a signal would."), end)
    bench.post("a")
    bench.post("b", service="test/end")
    for _ in range(20):
        bench.mailbox.post(
            Call("test/cost", {}, "c"), lambda reply: refused.append(reply.fault.code if reply.fault else "")
        )
    bench.simulation.run()
    bench.bus.drain()
    assert [source for _, _, source in bench.seen] == ["a", "b"]
    assert refused == ["shutdown"] * 20
