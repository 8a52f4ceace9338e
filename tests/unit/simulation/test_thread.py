"""The simulation thread: modes, steering, goals, lockstep, faults. Real threads, but bounded and without timing asserts.

Also of uwserver.simulation.goal.
"""

from __future__ import annotations

import gc
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulation_rig import FREE, PATIENCE_S, Rig, running

from uwserver.ports import Call, Command, Progress, Refused, Reply
from uwserver.ports.checks import checked_args
from uwserver.scenario.build.world import build
from uwserver.simulation.clock import Timing
from uwserver.simulation.thread import CLOCK_SERVICES, MAX_GOALS
from uwserver.world.state import snapshot
from uwserver.world.state.saving import in_one_piece


def test_step_runs_exactly_n_ticks_and_pauses(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        assert rig.call("world/step", n=7).tick == 7
        assert rig.call("world/step", n=1).tick == 8
        assert rig.world.tick == 8
        assert rig.simulation.paused


def test_a_paused_world_answers_commands_and_calls_at_once(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        assert rig.post(Command("rov/thrusters", ((0.5,) * 8,), "me")).tick == 0
        assert rig.post(Call("world/state_hash", {})).result["tick"] == 0
        rig.call("world/step", n=24)
        assert rig.world.vehicles["rov"].nu[2] > 0.0


def test_step_is_refused_while_the_world_runs_by_itself(resolved):
    with running(resolved) as rig:
        reply = rig.call("world/step", n=1)
        assert reply.fault.code == "busy"
        assert "world/pause" in reply.fault.text


def test_pause_resume(resolved):
    with running(resolved) as rig:
        rig.call("world/pause")
        tick = rig.world.tick
        assert rig.post(Call("world/state_hash", {})).tick == tick
        rig.event("paused")
        rig.call("world/resume")
        rig.event("resumed")
        assert rig.call("world/run_until", t_s=rig.world.t_ns * 1e-9 + 1.0).tick > tick


def test_run_until_reaches_the_tick_at_or_after_t_and_pauses_a_paused_world(resolved):
    with running(resolved, Timing(mode="freerun", paused=True)) as rig:
        assert rig.call("world/run_until", t_s=0.5).tick == 120
        assert rig.call("world/run_until", t_s=0.5001).tick == 121
        assert rig.simulation.paused
        reply = rig.call("world/run_until", t_s=0.1)
        assert reply.fault.code == "out_of_range"


def test_run_until_comes_to_the_tick_whose_time_was_told_and_no_further(resolved):
    with running(resolved, Timing(mode="freerun", paused=True)) as rig:
        for tick in range(1, 10):
            told = rig.world.ticks.time_of(tick) / 1e9
            assert [rig.call("world/run_until", t_s=told).tick for _ in range(2)] == [tick, tick]


def test_run_until_tick_reaches_that_tick_and_pauses_a_paused_world(resolved):
    with running(resolved, Timing(mode="freerun", paused=True)) as rig:
        for tick in (0, 7, 7, 8, 120):
            reply = rig.call("world/run_until_tick", tick=tick)
            assert (reply.tick, reply.fault) == (tick, None)
        assert rig.simulation.paused
        fault = rig.call("world/run_until_tick", tick=119).fault
        assert (fault.code, fault.where, fault.text) == (
            "out_of_range",
            "tick",
            "the world stands at tick 120, t = 0.5 s: that is past already",
        )


def test_a_long_run_tells_progress_and_can_be_cancelled(resolved):
    with running(resolved, Timing(speed=1.0, paused=True)) as rig:
        answers, cancel = rig.begin("world/run_until", t_s=3600.0)
        progress = answers.get(timeout=PATIENCE_S)
        assert isinstance(progress, Progress)
        assert 0.0 <= progress.fraction < 1.0
        assert cancel()
        reply = rig.final(answers)
        assert reply.fault.code == "preempted"
        assert not cancel()
        assert rig.call("world/step", n=1).fault is None


def test_pausing_preempts_a_run(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        answers, _ = rig.begin("world/run_until", t_s=3600.0)
        answers.get(timeout=PATIENCE_S)
        rig.call("world/pause")
        assert rig.final(answers).fault.code == "preempted"


def test_set_speed_is_for_realtime(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        assert rig.call("world/set_speed", speed=5.0).fault is None
        assert rig.simulation.pace.speed == 5.0
    with running(resolved) as rig:
        assert rig.call("world/set_speed", speed=5.0).fault.code == "denied"


def test_lockstep_goes_as_far_as_all_named_clients_let_it(resolved):
    timing = Timing(mode="lockstep", lockstep_clients=("a", "b"), lockstep_timeout_s=0.0)
    with running(resolved, timing) as rig:
        a, _ = rig.begin("world/step", client="a", n=5)
        b, _ = rig.begin("world/step", client="b", n=3)
        assert rig.final(b).tick == 3
        b, _ = rig.begin("world/step", client="b", n=2)
        assert rig.final(a).tick == 5
        assert rig.final(b).tick == 5
        assert rig.world.tick == 5
        stranger = rig.final(rig.begin("world/step", client="c", n=1)[0])
        assert stranger.fault.code == "denied"


@pytest.mark.parametrize(("policy", "event"), [("wait", "paused"), ("pause", "paused"), ("continue", "resumed")])
def test_lockstep_states_what_it_does_without_a_client(resolved, policy, event):
    timing = Timing(mode="lockstep", lockstep_clients=("a", "b"), lockstep_timeout_s=0.05, on_loss=policy)
    with running(resolved, timing) as rig:
        a, _ = rig.begin("world/step", client="a", n=2)
        told = rig.event(event)
        assert "b" in told.text
        if policy == "continue":
            assert rig.final(a).tick == 2
        elif policy == "wait":
            rig.begin("world/step", client="b", n=2)
            assert rig.final(a).tick == 2
        else:
            assert rig.simulation.paused


def test_a_pause_for_a_lost_client_is_told_once_and_its_grant_does_not_end_it(resolved):
    timing = Timing(mode="lockstep", lockstep_clients=("a", "b"), lockstep_timeout_s=0.02, on_loss="pause")
    with running(resolved, timing) as rig:
        a, _ = rig.begin("world/step", client="a", n=2)
        rig.event("paused")
        b, _ = rig.begin("world/set_speed", speed=1.0)  # answered after at least one more turn
        rig.final(b)
        time.sleep(0.1)  # five more time-outs
        assert rig.events.empty()
        assert rig.world.tick == 0
        rig.call("world/resume")
        rig.begin("world/step", client="b", n=2)
        assert rig.final(a).tick == 2


def test_a_very_slow_world_hears_at_once(resolved):
    """A tick lasts more than an hour."""
    with running(resolved, Timing(speed=1e-6)) as rig:
        for _ in range(10):
            assert rig.call("world/set_speed", speed=1e-6).fault is None
        assert rig.call("world/pause").fault is None


def test_what_was_frozen_for_the_run_is_collected_again_afterwards(resolved, monkeypatch):
    monkeypatch.setattr("uwserver.simulation.thread.gc", gc)
    gc.unfreeze()
    try:
        with running(resolved, Timing(paused=True)) as rig:
            rig.call("world/step", n=1)
            assert gc.get_freeze_count() > 0
        assert gc.get_freeze_count() == 0
    finally:
        gc.freeze()  # what all tests have made


def test_a_diverged_world_stops_is_told_and_runs_again_after_a_reset(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        answers, _ = rig.begin("world/run_until", t_s=3600.0)
        answers.get(timeout=PATIENCE_S)
        rig.simulation.steer(lambda: rig.world.hydro.state.__setitem__((0, 7), np.nan))
        assert '"rov" diverged' in rig.event("diverged").text
        assert rig.final(answers).fault is not None
        assert rig.call("world/resume").fault.code == "denied"
        assert rig.call("world/step", n=1).fault.code == "denied"
        assert rig.post(Call("world/reset", {})).fault is None
        assert rig.call("world/step", n=3).tick == 3
        assert rig.simulation.failure == ""


def test_a_load_of_a_world_that_diverges_at_once_is_told_in_full(resolved):
    """The state was good as a state: the load is answered with its tick, those who hear are told of the jump and then of the end, and the world
    stands as after any other divergence."""
    wild = build(resolved)
    wild.step(5)
    wild.hydro.state[0, 7:13] = 1e200  # finite, but not its square
    data = snapshot.to_bytes(wild, snapshot.take(wild))
    with running(resolved) as rig:
        goal, _ = rig.begin("world/run_until", t_s=1e8)
        reply = rig.post(Call("world/load", in_one_piece(data)))
        assert (reply.fault, reply.result) == (None, {"tick": 5, "t_ns": wild.t_ns})
        told = [rig.events.get(timeout=PATIENCE_S) for _ in range(2)]
        assert [event.event for event in told] == ["reset", "diverged"]
        assert told[0].text == "the world is at a saved state of tick 5"
        assert '"rov" diverged' in told[1].text
        fault = rig.final(goal).fault
        assert (fault.code, fault.text) == ("preempted", "the world was reset or restored")
        later = rig.call("world/resume").fault
        assert later.code == "denied"
        assert '"rov" diverged' in later.text
        assert "world/reset" in later.text
        assert rig.post(Call("world/load", in_one_piece(data))).fault is None, (
            "it may be asked again; it does not run by itself"
        )
        assert rig.post(Call("world/reset", {})).result is None
        assert rig.call("world/step", n=3).tick == 3
        assert rig.simulation.failure == ""


def test_every_mode_gives_the_same_bits(resolved):
    """Commands at fixed ticks: free-run by steps, real time at speed 50, lock-step, in process."""

    def script(rig: Rig, advance: Callable[[int], Reply]) -> str:
        for k in range(4):
            assert rig.post(Command("rov/thrusters", ((0.2 * k,) * 8,), "me")).tick == 60 * k
            advance(60)
        return rig.post(Call("world/state_hash", {})).result["hash"]

    hashes = []
    with running(resolved, Timing(paused=True)) as rig:
        hashes.append(script(rig, lambda n: rig.call("world/step", n=n)))
    with running(resolved, Timing(speed=50.0, paused=True)) as rig:
        until = (rig.call("world/run_until", t_s=0.25 * k) for k in range(1, 5))
        hashes.append(script(rig, lambda n: next(until)))
    lockstep = Timing(mode="lockstep", lockstep_clients=("me",), lockstep_timeout_s=0.0)
    with running(resolved, lockstep) as rig:
        hashes.append(script(rig, lambda n: rig.call("world/step", n=n)))
    world = build(resolved)
    for k in range(4):
        world.submit(Command("rov/thrusters", ((0.2 * k,) * 8,), "me"))
        world.step(60)
    hashes.append(snapshot.take(world).hash())
    assert len(set(hashes)) == 1


def test_the_observer_sees_requests_with_their_tick_and_every_tick(resolved):
    class Notes:
        def __init__(self) -> None:
            self.requests: list = []
            self.ticks: list[int] = []

        def requested(self, item, tick: int, batch: int) -> None:
            self.requests.append((tick, type(item).__name__))

        def ticked(self, world) -> None:
            self.ticks.append(world.tick)

        def next_tick(self, tick) -> int:
            return tick + 1

    notes = Notes()
    rig = Rig(resolved, Timing(paused=True))
    rig.simulation.observe(notes)
    rig.start()
    rig.call("world/step", n=3)
    rig.post(Command("rov/thrusters", ((0.1,) * 8,), "me"))
    rig.call("world/step", n=2)
    rig.end()
    assert notes.ticks == [1, 2, 3, 4, 5]
    assert notes.requests == [(3, "Command")]


def test_ending_answers_what_is_under_way(resolved):
    rig = Rig(resolved, Timing(paused=True))
    rig.start()
    answers, _ = rig.begin("world/run_until", t_s=3600.0)
    answers.get(timeout=PATIENCE_S)
    rig.end()
    assert rig.final(answers).fault.code == "shutdown"


def test_a_slow_loop_loses_nothing_in_freerun(resolved):
    with running(resolved, replace(FREE, paused=True)) as rig:
        rig.call("world/run_until", t_s=20.0)
    seqs = [s.seq for s in rig.samples if s.port == "rov/imu"]
    assert seqs == list(range(len(seqs)))
    assert len(seqs) == 20 * 120 - 1, "the last is under way yet: the IMU delivers 2 ms late"
    assert rig.bus.dropped == 0


def test_ticks_in_one_go_end_where_somebody_waits_for_one(resolved):
    """Goals, the last tick of a run, and callbacks; and each tick is counted."""
    kept = []
    rig = Rig(resolved, FREE)
    rig.simulation.until_tick = 500
    for tick in (37, 38, 191):
        rig.simulation.call_at(tick, lambda: kept.append(rig.world.tick))
    lengths = spied(rig.world)
    rig.simulation.run()
    assert kept == [37, 38, 191]
    assert rig.world.tick == rig.simulation.lateness.ticks == 500
    assert max(lengths) > 20
    with running(resolved, replace(FREE, paused=True)) as rig:
        lengths = spied(rig.world)
        for tick in (5, 6, 60, 301):
            assert rig.call("world/run_until_tick", tick=tick).tick == rig.world.tick == tick
        assert max(lengths) > 20
        assert rig.simulation.lateness.ticks == 301


def test_who_asks_is_answered_before_ticks_in_one_go(resolved):
    rig = Rig(resolved, FREE)  # whose loop does nothing
    rig.simulation.until_tick = 100
    said, real = [], rig.bus.publish
    rig.bus.publish = rig.simulation._publish = lambda output, wake=True: (
        said.append((output.tick, [reply.tick for _, reply in output.replies])),
        real(output, wake),
    )
    lengths = spied(rig.world)
    for item in (Command("rov/thrusters", ((0.5,) * 8,), "me"), Call("world/state_hash", {})):
        rig.mailbox.post(item, lambda reply: None)
    rig.simulation.run()
    assert said[0] == (0, [0, 0])
    assert not any(replies for _, replies in said[1:])
    assert max(lengths) > 20
    assert rig.world.vehicles["rov"].nu[2] > 0.0


def test_what_comes_while_others_are_answered_waits_for_one_tick(resolved):
    rig = Rig(resolved, FREE)  # whose loop does nothing
    rig.simulation.until_tick = 100
    said, real = [], rig.bus.publish

    def publish(output, wake=True):
        if output.replies and not said:  # of the first one
            rig.mailbox.post(Call("world/state_hash", {}), lambda reply: None)
        said.extend(reply.tick for _, reply in output.replies)
        real(output, wake)

    rig.bus.publish = rig.simulation._publish = publish
    lengths = spied(rig.world)
    rig.simulation.call_at(30, lambda: rig.mailbox.post(Call("world/state_hash", {}), lambda reply: None))
    rig.simulation.run()
    assert said == [30, 31]
    assert rig.world.tick == 100
    assert max(lengths) > 20


def test_what_needs_no_answer_wakes_nobody(resolved):
    """What samples wait for the loop goes with the next that may wake it."""
    rig = Rig(resolved, FREE)  # whose loop does nothing
    rig.simulation.until_tick = 100
    wakes, real = [], rig.bus.publish

    def publish(output, wake=True):
        wakes.append((output.tick, wake))
        real(output, wake)

    rig.bus.publish = rig.simulation._publish = publish
    rig.mailbox.post(Command("rov/thrusters", ((0.5,) * 8,), "me"), None)
    rig.simulation.run()
    assert wakes[0] == (0, False)


def test_a_load_among_what_is_asked_is_followed_at_once(resolved):
    """Ticks in one go end where a run ends, counted from where the world stands then."""
    rig = Rig(resolved, FREE)
    for _ in range(90):
        rig.world.step(1)
    ahead = in_one_piece(snapshot.to_bytes(rig.world, snapshot.take(rig.world)))
    rig.world.call("world/reset")
    rig.simulation.until_tick = 100
    lengths = spied(rig.world)
    rig.mailbox.post(Call("world/load", ahead), lambda reply: None)
    rig.simulation.run()
    assert rig.world.tick == 100
    assert rig.simulation.lateness.ticks < 20
    assert lengths[1] == 1, "the tick in which the time was set is made by itself"


def test_ticks_in_one_go_are_no_more_than_the_loop_may_be_behind(resolved):
    """Who asks something waits for no more work of the loop than before."""
    rig = Rig(resolved, FREE)  # whose loop does nothing
    rig.bus.ahead = 4
    lengths = spied(rig.world)
    thread = threading.Thread(target=rig.simulation.run)
    thread.start()
    end = time.monotonic() + PATIENCE_S
    while rig.bus.backlog() < 4 and time.monotonic() < end:
        time.sleep(0.001)
    time.sleep(0.05)
    behind = rig.bus.backlog()
    rig.simulation.stop()
    thread.join()
    assert behind == 4
    assert 0 < max(lengths) <= 4


def spied(world):
    """How many ticks each call of `advance` makes from now on."""
    lengths, real = [0], world.advance

    def advance(*args, **kwargs):
        output = real(*args, **kwargs)
        lengths.append(output.ticks)
        return output

    world.advance = advance
    return lengths


def test_who_looks_at_each_tick_sees_each(resolved):
    """A clock that paces them, a barrier in lockstep, and an observer those that it asks for."""

    class Observer:
        def __init__(self, every: int) -> None:
            self.every, self.ticks = every, list[int]()

        def requested(self, item, tick, batch) -> None: ...

        def ticked(self, world) -> None:
            self.ticks.append(world.tick)

        def next_tick(self, tick) -> int:
            return tick + self.every - tick % self.every

    for every in (1, 12):
        rig, observer = Rig(resolved, FREE), Observer(every)
        rig.simulation.until_tick = 120
        rig.simulation.observe(observer)
        lengths = spied(rig.world)
        rig.simulation.run()
        assert {*range(every, 121, every)} <= {*observer.ticks}
        assert (max(lengths), sum(lengths)) == (every, 120)
    with running(resolved, Timing(speed=100.0)) as rig:
        lengths = spied(rig.world)
        rig.call("world/run_until_tick", tick=50)
        assert max(lengths) == 1


def test_a_step_cancelled_before_it_began_never_runs(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        both_are_there = threading.Event()
        rig.simulation.steer(lambda: both_are_there.wait(PATIENCE_S))
        answers, cancel = rig.begin("world/step", n=10**9)
        assert cancel()
        both_are_there.set()
        assert rig.final(answers).fault.code == "preempted"
        assert not cancel()
        assert rig.call("world/step", n=1).fault is None


def test_a_paused_world_in_lockstep_steps_without_grants(resolved):
    with running(resolved, Timing("lockstep", paused=True, lockstep_clients=("me", "other"))) as rig:
        assert rig.call("world/step", n=5).tick == 5
        assert rig.call("world/run_until", t_s=0.1).tick == 24
        rig.call("world/resume")
        both = [rig.begin("world/step", n=2, client=name)[0] for name in ("me", "other")]
        assert [rig.final(answers).tick for answers in both] == [26, 26]


def test_resume_turns_a_step_into_time_that_goes_on(resolved):
    with running(resolved, Timing(speed=1000.0, paused=True)) as rig:
        answers, _ = rig.begin("world/step", n=3000)
        rig.call("world/resume")
        assert rig.final(answers).tick == 3000
        assert not rig.simulation.paused
        assert rig.call("world/run_until", t_s=20.0).tick == 4800


def test_a_restore_that_is_refused_changes_nothing(resolved):
    with running(resolved, Timing(speed=1000.0)) as rig:
        answers, _ = rig.begin("world/run_until", t_s=60.0)
        assert rig.post(Call("world/restore", {"name": "typo"})).fault.code == "bad_argument"
        assert rig.final(answers).fault is None


def test_a_diverged_world_answers_that_tick_and_stays_stopped_after_a_refused_restore(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        rig.world.hydro.state[0, 7] = np.nan
        command: queue.Queue = queue.Queue()
        both_are_there = threading.Event()
        rig.simulation.steer(lambda: both_are_there.wait(PATIENCE_S))
        answers, _ = rig.begin("world/step", n=3)
        rig.mailbox.post(Command("rov/thrusters", ((0.5,) * 8,), "me"), command.put)
        both_are_there.set()
        assert rig.final(answers).fault.code == "internal"
        assert rig.final(command).tick == 0
        assert rig.post(Call("world/restore", {"name": "typo"})).fault.code == "bad_argument"
        assert rig.call("world/step", n=1).fault.code == "denied"


def test_a_run_has_its_last_tick_whatever_clients_do(resolved):
    rig = Rig(resolved, Timing(speed=1000.0))
    rig.simulation.until_tick = rig.world.ticks.at(10.0)
    rig.start()
    rig.call("world/pause")
    rig.call("world/resume")
    rig._thread.join(PATIENCE_S)
    rig.end()
    assert rig.world.tick == 2400


def test_who_still_waits_at_the_end_is_answered(resolved):
    rig = Rig(resolved, Timing(paused=True))
    step, _ = rig.begin("world/step", n=5)
    pause, _ = rig.begin("world/pause")
    posted: queue.Queue = queue.Queue()
    rig.mailbox.post(Call("world/state_hash", {}), posted.put)
    rig.simulation.stop()
    rig.start()
    rig.end()
    assert [rig.final(answers).fault.code for answers in (step, posted)] == ["preempted", "shutdown"]
    assert rig.final(pause).fault is None


def test_run_until_has_a_largest_time():
    service = next(service for service in CLOCK_SERVICES if service.path == "world/run_until")
    with pytest.raises(Refused, match="at most"):
        checked_args(service, {"t_s": 1e300})


def test_as_many_runs_as_can_be_told_their_progress_and_no_more(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        runs = [rig.begin("world/run_until", t_s=3600.0) for _ in range(MAX_GOALS)]
        fault = rig.call("world/run_until", t_s=3600.0).fault
        assert (fault.code, fault.text.split(" ")[0]) == ("overload", "256")
        assert runs[0][1]()
        assert rig.final(runs[0][0]).fault.code == "preempted"
        assert rig.begin("world/run_until", t_s=3600.0)[1]()
