"""Drivers: who sets the pace from the simulation thread. Real threads, bounded, without timing asserts."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence

import pytest
from lock_rig import Door
from msgspec.structs import replace
from simulation_rig import PATIENCE_S, Rig, running

from uwserver.adapter import Order
from uwserver.ports import Call, Command, Fault, Refused, Reply, Sample
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Timing
from uwserver.simulation.lockstep import Lockstep
from uwserver.testing import MockTime
from uwserver.units import NANOSECONDS

LOCKED = Timing(mode="lockstep", lockstep_clients=("a",), lockstep_timeout_s=0.0)


class Hand:
    """A driver whose orders a test gives, and which tells what it is told."""

    def __init__(self) -> None:
        self.orders: queue.Queue[Order] = queue.Queue()
        self.answers: queue.Queue[int] = queue.Queue()
        self.faults: list[Fault] = []
        self.seen: list[int] = []
        self.ports: set[str] = set()
        self.threads: set[str] = set()
        self.raises: Exception | None = None

    def order(self, wait_s: float) -> Order | None:
        self.threads.add(threading.current_thread().name)
        if self.raises is not None:
            raise self.raises
        try:
            return self.orders.get(timeout=wait_s) if wait_s else self.orders.get_nowait()
        except queue.Empty:
            return None

    def see(self, t_ns: int, samples: Sequence[Sample]) -> None:
        self.seen.append(t_ns)
        self.ports |= {sample.port for sample in samples}

    def answer(self, t_ns: int) -> None:
        self.answers.put(t_ns)

    def refuse(self, fault: Fault) -> None:
        self.faults.append(fault)

    def step(self, ticks: int = 1, *commands: tuple[str, dict[str, object]]) -> int:
        """Order, and wait for the answer: its time."""
        self.orders.put(Order(ticks, commands))
        return self.answers.get(timeout=PATIENCE_S)


def test_samples_of_a_world_that_nobody_paces_wake_the_loop_fifty_times_a_second():
    for mode, wakes in (("freerun", 50), ("realtime", 1000)):
        time = MockTime(NANOSECONDS)
        lockstep = Lockstep(Timing(mode=mode), time, Bus(print), print, print)
        woken = 0
        for _ in range(1000):
            time.pass_time(0.001)
            woken += lockstep.wakes()
        assert woken == wakes


def drive(rig: Rig, hand: Hand, client: str = "a", replies: queue.Queue | None = None):
    return rig.simulation.lockstep.drive(client, f"sil:{client}", hand, (replies or queue.Queue()).put)


def test_an_order_is_so_many_ticks_and_its_command_acts_in_the_first(resolved):
    with running(resolved, LOCKED) as rig:
        hand = Hand()
        end = drive(rig, hand)
        assert hand.step() == rig.world.ticks.time_of(1)
        assert hand.step(5, ("rov/thrusters", {"u": [0.5] * 8})) == rig.world.ticks.time_of(6)
        assert rig.world.tick == 6
        assert rig.world.actuators["rov/thrusters"].last_tick == 1
        assert rig.world.actuators["rov/thrusters"].source == "sil:a"
        assert hand.seen == [rig.world.ticks.time_of(n) for n in range(1, 7)]
        end()
        assert rig.world.tick == 6


def test_a_driver_goes_without_what_it_cannot_read(resolved):
    """Another body may have come under the name of the one that it found when it began, with other fields."""
    with running(resolved, LOCKED) as rig:
        hand = Hand()
        end = drive(rig, hand)
        hand.step(24)
        assert "rov/imu" in hand.ports
        ports = rig.world.ports
        imu = ports["rov/imu"]
        for changed, is_seen in ((replace(imu, fields=imu.fields[1:]), False), (replace(imu, rate_hz=1.0), True)):
            rig.world.ports = {**ports, "rov/imu": changed}
            hand.ports.clear()
            hand.step(24)
            assert ("rov/imu" in hand.ports) == is_seen
            assert len(hand.ports) > 1
        end()


def test_others_get_every_sample_and_their_calls_are_answered(resolved):
    with running(resolved, LOCKED) as rig:
        hand = Hand()
        end = drive(rig, hand)
        assert rig.post(Call("world/state_hash", {})).result["tick"] == 0, "while it waits for the driver"
        for _ in range(50):
            hand.step()
        assert rig.post(Call("world/state_hash", {})).result["tick"] == 50
        sent = [sample.seq for sample in rig.samples if sample.port == "rov/imu"]
        assert sent == list(range(len(sent)))
        divisor = rig.world.sensors["rov/imu"].divisor
        assert len(sent) == len(hand.seen) // divisor - 1, "the last is under way yet: the IMU delivers 2 ms late"
        end()


def test_the_recorder_sees_what_a_driver_commands(resolved):
    seen = []

    class Observer:
        def requested(self, item, tick, batch):
            seen.append((item, tick))

        def ticked(self, world):
            pass

        def next_tick(self, tick):
            return tick + 1

    rig = Rig(resolved, LOCKED)
    rig.simulation.observe(Observer())
    rig.start()
    try:
        hand = Hand()
        drive(rig, hand)
        hand.step(3)
        hand.step(1, ("rov/thrusters", {"u": [0.25] * 8}))
    finally:
        rig.end()
    assert seen == [(Command("rov/thrusters", ((0.25,) * 8,), "sil:a"), 3)]


def test_a_bad_command_is_refused_and_the_tick_is_done(resolved):
    with running(resolved, LOCKED) as rig:
        hand = Hand()
        drive(rig, hand)
        for command, code in (
            (("rov/thrusters", {"u": [2.0] * 8}), "out_of_range"),
            (("rov/thrusters", {"u": [float("nan")] * 8}), "not_finite"),
            (("rov/wings", {"u": [0.0]}), "unknown_port"),
        ):
            hand.step(1, command)
            assert hand.faults.pop().code == code
        assert rig.world.tick == 3
        assert rig.world.actuators["rov/thrusters"].last_tick == -1


def test_a_driver_waits_with_the_other_clients(resolved):
    timing = Timing(mode="lockstep", lockstep_clients=("a", "b", "c"), lockstep_timeout_s=0.0)
    with running(resolved, timing) as rig:
        first, second = Hand(), Hand()
        drive(rig, first)
        drive(rig, second, "b")
        answers, _ = rig.begin("world/step", client="c", n=2)
        first.orders.put(Order(2, ()))
        assert rig.world.tick == 0
        second.orders.put(Order(1, ()))
        assert second.answers.get(timeout=PATIENCE_S) == rig.world.ticks.time_of(1)
        assert first.answers.empty()
        second.orders.put(Order(1, ()))
        assert (
            second.answers.get(timeout=PATIENCE_S)
            == rig.world.ticks.time_of(2)
            == first.answers.get(timeout=PATIENCE_S)
        )
        assert rig.final(answers).tick == 2


def test_a_driver_that_is_let_go_is_not_called_any_more(resolved):
    with running(resolved, LOCKED) as rig:
        hand = Hand()
        end = drive(rig, hand)
        hand.step()
        end()
        hand.raises = AssertionError("called after its end")
        hand.orders.put(Order(1, ()))
        assert rig.post(Call("world/state_hash", {})).result["tick"] == 1
        assert rig.simulation.lockstep.barrier.absent() == ["a"]
        other = Hand()
        drive(rig, other)
        other.step()
        assert not rig.simulation.failure


def test_who_lets_a_driver_go_waits_until_it_is_called_no_more():
    """Its socket is closed then."""
    lockstep, door, inside, seen = Lockstep(LOCKED, MockTime(), Bus(print), print, print), Door(), threading.Event(), []

    class Busy(Hand):
        def order(self, wait_s: float) -> Order | None:
            inside.set()
            door.waited.wait(PATIENCE_S)
            seen.append("called")
            return None

    leave = lockstep.drive("a", "sil:a", Busy(), print)
    lockstep._drivers["a"].held = door
    simulation = threading.Thread(target=lambda: list(lockstep.orders(1, {})))
    simulation.start()
    assert inside.wait(PATIENCE_S)
    leave()
    seen.append("gone")
    door.waited.set()
    simulation.join()
    assert seen == ["called", "gone"]


def test_a_driver_that_fails_is_told_and_the_world_waits(resolved):
    with running(resolved, LOCKED) as rig:
        hand, replies = Hand(), queue.Queue()
        drive(rig, hand, replies=replies)
        hand.step()
        hand.raises = ValueError("no")
        reply = replies.get(timeout=PATIENCE_S)
        assert isinstance(reply, Reply)
        assert reply.fault.code == "internal"
        assert "ValueError: no" in reply.fault.text
        assert rig.post(Call("world/state_hash", {})).result["tick"] == 1
        assert not rig.simulation.failure


def test_who_may_drive(resolved):
    with running(resolved, LOCKED) as rig:
        drive(rig, Hand())
        with pytest.raises(Refused, match="a driver"):
            drive(rig, Hand())
        with pytest.raises(Refused, match='lockstep_clients = \\["b"\\]'):
            drive(rig, Hand(), "b")
    with running(resolved, Timing(mode="realtime", lockstep_clients=("a",))) as rig:
        with pytest.raises(Refused, match='mode = "lockstep"'):
            drive(rig, Hand())


def test_a_reset_answers_what_was_ordered(resolved):
    with running(resolved, LOCKED) as rig:
        hand = Hand()
        drive(rig, hand)
        hand.step(10)
        assert rig.post(Call("world/reset", {})).fault is None
        assert hand.step() == rig.world.ticks.time_of(1)
        answers = queue.Queue()
        rig.mailbox.post(Call("world/reset", {}), answers.put)  # carried out in the tick of the order, or before it
        assert hand.step(1) <= rig.world.ticks.time_of(2)
        assert rig.final(answers).fault is None
        assert hand.step(1) <= rig.world.ticks.time_of(3)


def test_a_paused_world_asks_no_driver_and_goes_on_after_it(resolved):
    with running(resolved, LOCKED) as rig:
        hand = Hand()
        drive(rig, hand)
        hand.step()
        rig.call("world/pause")
        hand.orders.put(Order(1, ()))
        assert rig.call("world/step", n=4).tick == 5
        assert hand.answers.empty() or hand.answers.get() <= rig.world.ticks.time_of(5)
        rig.call("world/resume")
        while rig.world.tick < 5 or not hand.orders.empty():
            hand.answers.get(timeout=PATIENCE_S)
        hand.step()
        assert hand.seen == [rig.world.ticks.time_of(n + 1) for n in range(len(hand.seen))]


def test_the_world_goes_on_without_a_lost_driver_and_takes_it_back(resolved):
    timing = Timing(mode="lockstep", lockstep_clients=("a",), lockstep_timeout_s=0.05, on_loss="continue")
    with running(resolved, timing) as rig:
        hand = Hand()
        drive(rig, hand)
        hand.step()
        rig.event("resumed")
        while len(hand.seen) < 100:  # ticks that nobody ordered
            rig.post(Call("world/state_hash", {}))
        assert hand.step() > rig.world.ticks.time_of(100)


def test_lockstep_can_hold_real_time(resolved):
    timing = Timing(mode="lockstep", lockstep_clients=("a",), lockstep_timeout_s=0.0, max_speed=1000.0)
    assert timing.pace == 1000.0
    assert Timing(mode="lockstep").pace is None
    assert Timing(mode="freerun").pace is None
    assert Timing(mode="realtime", speed=3.0).pace == 3.0
    with running(resolved, timing) as rig:
        hand = Hand()
        drive(rig, hand)
        hand.step(10)
        assert sum(rig.simulation.lateness.counts) == 10, "each tick had a deadline"
        assert rig.call("world/set_speed", speed=2000.0).fault is None
