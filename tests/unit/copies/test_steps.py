"""Many ticks in one call are as many calls of one tick, whatever happens within them, and whatever the number of threads.

Each copy is stepped in one of the threads, is done when the call returns, and no thread is left behind.
"""

from __future__ import annotations

import gc
import os
import signal
import threading
import warnings

import numpy as np
import pytest

import uwserver
from uwserver.copies import steps
from uwserver.copies.steps import LEAST_COPIES, MOST_THREADS, Ranges, threads_for
from uwserver.ports import Refused
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.world.sensing.sensor_arrays import SensorArrays

N = 7
DIFFERING = {
    "command_latency": [0.0, 0.1, 0.25, 0.5, 0.05, 0.0, 0.3],
    "latency": [0.0, 0.5, 0.1, 0.8, 0.2, 0.0, 0.4],
    # Copy 5 falls apart some 50 ticks after its start.
    "mass": [1, 1, 1, 1, 1, 0.1, 1],
    "added_mass": [1, 1, 1, 1, 1, 0, 1],
    "damping": [1, 1, 1, 1, 1, 0, 1],
}


def busy():
    """Waves, a drifting current, sensors of six rates with errors and delays, a watchdog of 240 ticks, a battery, and two faults."""
    b = ScenarioBuilder("busy", seed=5, rate_hz=240)
    b.environment(density_kgpm3=1025).current(velocity_ned_mps=[0.2, -0.1, 0.0])
    b.add_current("gusts", "gauss_markov", sigma_ned_mps=[0.1, 0.1, 0.02], tau_s=2.0)
    b.waves(significant_height_m=0.5, peak_period_s=5, direction_deg=30, components=8)
    b.vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3])
    b.truth("rov", rate_hz=10)
    b.sensor("rov", "imu", "imu", rate_hz=240, profile="mems_imu")
    b.sensor("rov", "ahrs", "attitude", rate_hz=40, profile="mems_ahrs", latency_s=0.02)
    b.sensor("rov", "dvl", "dvl", rate_hz=8, profile="a50")
    b.stream("rov", "dvl", "exact", ideal=True)
    b.sensor("rov", "sonar", "altimeter", rate_hz=5, profile="ping1d")
    b.sensor("rov", "cell", "battery", rate_hz=2, profile="lipo_4s_18ah")
    b.modifier("rov", "ahrs", "wander", "gauss_markov", field="heading", sigma=0.01, tau_s=3)
    b.modifier("rov", "ahrs", "late", "delay", latency_s=0.05, jitter_s=0.03)
    b.modifier("rov", "imu", "lost", "dropout", probability=0.1)
    b.fault("weak", "thruster_weak", "rov/thrusters", members=["t1"], factor=0.4, at_s=0.4, until_s=1.3)
    b.fault("mute", "sensor_silent", "rov/ahrs", at_s=0.7, until_s=0.9)
    return b.build()


def slow():
    """Sensors that read each 6, 10 and 48 ticks: between them nothing is due."""
    b = ScenarioBuilder("slow", seed=2, rate_hz=240)
    b.vehicle("rov", "bluerov2_heavy_von_benzon", position_ned_m=[0, 0, 3])
    b.sensor("rov", "ahrs", "attitude", rate_hz=40, profile="mems_ahrs")
    b.sensor("rov", "imu", "imu", rate_hz=24, profile="mems_imu")
    b.sensor("rov", "sonar", "altimeter", rate_hz=5, profile="ping1d")
    return b.build()


def piloted():
    """An autopilot that holds its depth."""
    b = ScenarioBuilder("piloted", seed=3, rate_hz=240).current(velocity_ned_mps=[0.1, 0.0, 0.0])
    b.vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3], autopilot={"mode": "depth_hold", "armed": True})
    b.sensor("rov", "imu", "imu", rate_hz=60, profile="mems_imu")
    b.sensor("rov", "ahrs", "attitude", rate_hz=40, profile="mems_ahrs")
    b.sensor("rov", "pressure", "pressure", rate_hz=40, profile="bar30")
    return b.build()


def finned():
    """A vehicle with appendages."""
    b = ScenarioBuilder("fins", seed=1, rate_hz=240).vehicle("auv", "remus100", position_ned_m=[0, 0, 5])
    b.truth("auv", rate_hz=40)
    return b.build()


def pair(scenario, n, threads, **given):
    """Two batches alike; the second has one thread."""
    return uwserver.batch(scenario, n, threads=threads, **given), uwserver.batch(scenario, n, threads=1, **given)


def step_both(ours, theirs, ticks):
    """In one call, and one by one."""
    told = ours.step(ticks)
    for _ in range(ticks):
        last = theirs.step()
    assert told.tolist() == last.tolist()


def check_alike(ours, theirs):
    """All that can be read is the same, bit by bit."""
    assert ours.ticks.tolist() == theirs.ticks.tolist()
    assert ours.t_s.tolist() == theirs.t_s.tolist()
    assert ours.diverged.tolist() == theirs.diverged.tolist()
    for vehicle in ours.vehicles:
        assert ours.states(vehicle).tobytes() == theirs.states(vehicle).tobytes()
    for port in ours.ports:
        one, other = ours.read(port), theirs.read(port)
        assert one.stamps.tolist() == other.stamps.tolist(), port
        assert one.packed.tobytes() == other.packed.tobytes(), port


def values_for(scenario, batch, rng):
    """Some for each actuator that takes bounded numbers; only the depth where an autopilot has the thrusters."""
    if scenario is piloted:
        return {"rov/autopilot/depth": {"depth": rng.uniform(2.0, 4.0, batch.n)}}
    firsts = {path: port.fields[0] for path, port in batch.commands.items()}
    return {
        path: {field.name: rng.uniform(0.0, 0.5 * field.maximum, (batch.n, *field.shape))}
        for path, field in firsts.items()
        if field.maximum is not None
    }


def of_each(events, n):
    """What happened to each copy, in its order."""
    return [[event for k, event in events if k == i] for i in range(n)]


@pytest.fixture
def rooms(monkeypatch):
    """Receives the arrays of the sensors of a world each time they are given more room for samples."""
    seen, make_room = [], SensorArrays.make_room

    def watched(self, most):
        before = self.room
        make_room(self, most)
        if self.room > before:
            seen.append(self)

    monkeypatch.setattr(SensorArrays, "make_room", watched)
    return seen


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.slow), 3])
def test_many_ticks_are_as_many_calls_whatever_happens_within(threads, rooms):
    """Commands and watchdogs at other ticks in each copy, faults, samples long on their way, clocks that differ, and a copy that falls apart."""
    ours, theirs = pair(busy(), N, threads, **DIFFERING)
    rng, happened, grown = np.random.default_rng(4), set(), []
    for ticks, anew in ((31, []), (300, [1, 3]), (7, [6]), (121, [0, 5]), (500, [2, 5]), (1, []), (90, [1, 2, 3, 4])):
        u, levels = (
            rng.uniform(-0.5, 0.5, (N, 8)),
            rng.uniform(0.0, 1.0, (4, *ours.commands["rov/lights"].fields[0].shape)),
        )
        for batch in (ours, theirs):
            batch.reset(np.array(anew, int))
            batch.command("rov/thrusters", u=u)
            batch.command("rov/lights", [1, 2, 5, 6], levels=levels)
        rooms.clear()
        step_both(ours, theirs, ticks)
        grown.append(sum(any(each is copy.world.sensor_arrays for copy in ours._copies) for each in rooms))
        check_alike(ours, theirs)
        (mine, others) = (batch.events() for batch in (ours, theirs))
        assert of_each(mine, N) == of_each(others, N)
        happened |= {event.event for _, event in mine}
    assert happened == {"watchdog", "fault"}
    assert max(grown) >= 2, "room was made several times within one call"
    assert len(set(ours.ticks.tolist())) >= 4, "clocks differ"
    assert ours.diverged.tolist() == [i == 5 for i in range(N)]
    assert 40 < ours.ticks[5] < 60, "within a call"
    ours.close()


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("scenario", [slow, piloted, finned])
def test_other_scenarios_too(scenario, threads):
    """With nothing to do between readings, with an autopilot, and with fins."""
    ours, theirs = pair(scenario(), 5, threads)
    rng = np.random.default_rng(6)
    for ticks, anew in ((7, []), (150, [1, 4]), (3, [2]), (200, [0])):
        for batch in (ours, theirs):
            batch.reset(np.array(anew, int))
        for path, value in values_for(scenario, ours, rng).items():
            for batch in (ours, theirs):
                batch.command(path, **value)
        step_both(ours, theirs, ticks)
        check_alike(ours, theirs)
        assert of_each(ours.events(), 5) == of_each(theirs.events(), 5)
    assert len(set(ours.ticks.tolist())) == 4
    ours.close()


@pytest.mark.parametrize("threads", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_events_have_the_order_of_single_ticks_among_all_copies(threads):
    """Though the range of copy 0, whose samples are long on their way, stops for room within a call, while the others go on."""
    given = {"latency": [0.8, 0, 0, 0, 0, 0], "command_latency": [0, 0, 0, 0, 0, 4 / 240]}
    ours, theirs = pair(busy(), 6, threads, **given)
    for batch in (ours, theirs):
        batch.command("rov/thrusters", u=np.full(8, 0.3))
    step_both(ours, theirs, 400)
    told = [(event.tick, i, event.event) for i, event in ours.events()]
    assert told == [(event.tick, i, event.event) for i, event in theirs.events()]
    assert [tick for tick, _, _ in told] == sorted(tick for tick, _, _ in told)
    assert {what for _, _, what in told} == {"watchdog", "fault"}
    ours.close()


def test_one_call_is_what_load_gives():
    """Of a world that is stepped tick by tick, with samples that are under way for long."""
    batch, world = uwserver.batch(busy(), 3, threads=3), uwserver.load(busy()).core
    batch.command("rov/thrusters", u=np.full(8, 0.5))
    world.command("rov/thrusters", u=[0.5] * 8)
    batch.step(600)
    for _ in range(600):
        world.step(1)
    assert batch.states()[0].tobytes() == world.hydro.state[0].tobytes()
    assert (batch.t_s[0], batch.ticks[0]) == (2.5, 600)
    for port in batch.ports:
        ours, theirs = batch.read(port), world.read(port)
        assert ours.stamps[0].tolist() == [theirs.seq, theirs.t_ns, theirs.t_sent_ns, theirs.valid], port
        for field in ours:
            wanted = np.array(theirs.array(field), ours[field].dtype)
            assert np.array_equal(ours[field][0], wanted, equal_nan=True), port
    batch.close()


@pytest.mark.parametrize("rate_hz", [pytest.param(333.3, marks=pytest.mark.slow), 333.333333, 1000 / 7])
def test_rates_that_are_no_whole_numbers_keep_the_times_of_a_world(rate_hz):
    """The last has 14 digits."""
    b = ScenarioBuilder("odd", rate_hz=rate_hz).vehicle("rov", "bluerov2_heavy_von_benzon", position_ned_m=[0, 0, 3])
    b.sensor("rov", "ahrs", "attitude", rate_hz=rate_hz, profile="mems_ahrs")
    batch, world = uwserver.batch(b.build(), 2), uwserver.load(b.build()).core
    for _ in range(2):
        batch.step(2500)
        world.step(2500)
        ours, theirs = batch.read("rov/ahrs"), world.read("rov/ahrs")
        assert ours.stamps[0].tolist() == [theirs.seq, theirs.t_ns, theirs.t_sent_ns, theirs.valid]


def test_a_call_ends_where_all_have_fallen_apart():
    batch = uwserver.batch(slow(), 4, threads=2, mass=0.1, added_mass=0.0, damping=0.0)
    batch._copies[0].world.hydro.state[0, 7] = np.nan
    with_nan = batch.step(5000)
    assert with_nan[0]
    assert batch.ticks[0] == 1
    for copy in batch._copies[1:]:
        copy.world.hydro.state[0, 7] = np.nan
    ticks = batch.ticks
    assert batch.step(5000).all()
    assert (batch.ticks <= ticks + 1).all()
    ended = batch.ticks.tolist()
    assert batch.step(3).all()
    assert batch.ticks.tolist() == ended
    batch.close()


def test_calls_into_python_are_as_few_as_what_happens(monkeypatch):
    """Between two events threads go on by themselves: nobody looks after each tick."""
    batch = uwserver.batch(slow(), 4)
    turns, run = [], batch._steps.ranges.run

    def watched(which, loop):
        turns.append(batch.ticks.tolist())
        run(which, loop)

    monkeypatch.setattr(batch._steps.ranges, "run", watched)
    batch.reset([1, 2], command_latency=[0.1, 0.0])
    batch.command("rov/thrusters", u=np.full(8, 0.2))
    batch.step(200)
    assert [turn[0] for turn in turns] == [0, 24]
    turns.clear()
    batch.step(200)  # watchdogs after 240 ticks without a command
    assert [turn[0] for turn in turns] == [200, 240, 264]


def living():
    return [thread for thread in threading.enumerate() if thread.name.startswith("uwserver-copies")]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("n", [0, 1, 2, 3, 5, 9, 64])
def test_every_copy_is_in_one_part_and_every_part_in_a_range_of_its_own(count, n):
    which, seen = np.arange(n) * 3, []
    shared = Ranges(count)
    shared.run(which, lambda part, k: seen.append((k, part.tolist())))
    assert [i for _, part in sorted(seen) for i in part] == which.tolist()
    assert len({k for k, _ in seen}) == len(seen)
    assert all(k < count for k, _ in seen)
    shared.close()


def test_ranges_are_at_work_at_the_same_time():
    """Each waits for the others, which would not come if one thread did them in turn."""
    shared, meet = Ranges(3), threading.Barrier(3, timeout=20)
    shared.run(np.arange(6), lambda part, k: meet.wait())
    shared.close()


def test_what_a_range_raises_comes_when_all_are_done():
    shared, begun, done = Ranges(2), threading.Event(), []

    def loop(part, k):
        if k == 0:
            assert begun.wait(20)
            raise ValueError("of the caller's range")
        begun.set()
        threading.Event().wait(0.05)  # so that whoever does not wait for this one is seen
        done.append(part.tolist())
        raise KeyError("of another")

    with pytest.raises(ValueError, match="caller's"):
        shared.run(np.arange(4), loop)
    assert done == [[2, 3]]

    def other(part, k):
        if k:
            raise KeyError("of another")

    with pytest.raises(KeyError, match="of another"):
        shared.run(np.arange(4), other)
    shared.close()


def test_no_thread_with_one_and_none_left_when_closed_or_dropped():
    before = len(living())
    Ranges(1).run(np.arange(9), lambda part, k: None)
    assert len(living()) == before
    shared = Ranges(2)
    assert len(living()) == before, "they begin with the first loop"
    shared.run(np.arange(9), lambda part, k: None)
    assert len(living()) == before + 1
    shared.close()
    assert (len(living()), shared.count) == (before, 1)
    parts = []
    shared.run(np.arange(9), lambda part, k: parts.append(len(part)))
    assert (len(living()), parts) == (before, [9])
    shared = Ranges(2)
    shared.run(np.arange(9), lambda part, k: None)
    (dropped,) = living()[before:]
    del shared
    gc.collect()
    dropped.join(20)
    assert not dropped.is_alive()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_has_threads_of_its_own():
    """Those of its parent are not there, and who waits for them waits for ever."""
    shared = Ranges(2)
    shared.run(np.arange(4), lambda part, k: None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        signal.alarm(20)
        seen = []
        shared.run(np.arange(4), lambda part, k: seen.append(len(part)))
        os._exit(0 if seen == [2, 2] else 3)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    shared.close()


def test_a_thread_a_core_where_there_are_copies_enough(monkeypatch):
    for cores, wanted in ((1, 1), (2, 2), (4, 4), (64, 4)):
        monkeypatch.setattr(steps, "cores", lambda cores=cores: cores)
        assert threads_for(LEAST_COPIES, None) == wanted
        assert threads_for(LEAST_COPIES - 1, None) == 1
        assert threads_for(1, 3) == 3
    for wrong in (0, -1, MOST_THREADS + 1):
        with pytest.raises(Refused, match="1 to 16 threads"):
            threads_for(1000, wrong)
