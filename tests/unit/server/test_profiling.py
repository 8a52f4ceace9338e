"""`world/profile` and `uwserver run --profile`: who asks is told, once, and the ticks are measured only meanwhile."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator

import pytest
from simulation_rig import PATIENCE_S, Rig, profiling_of, running

from uwserver.ports import Refused, Reply
from uwserver.server.profiling import MAX_MEASUREMENTS, PROFILE, Profiling
from uwserver.simulation.clock import Timing


class Later:
    """What the loop is to call later; the test decides when."""

    def __init__(self) -> None:
        self.calls: queue.Queue[tuple[float, Callable[[], None]]] = queue.Queue()

    def __call__(self, seconds: float, then: Callable[[], None]) -> None:
        self.calls.put((seconds, then))

    def take(self) -> tuple[float, Callable[[], None]]:
        return self.calls.get(timeout=PATIENCE_S)


@pytest.fixture
def still(resolved) -> Iterator[Rig]:
    with running(resolved, Timing(paused=True)) as rig:
        yield rig


def ask(profiling: Profiling, seconds: float = 2.0) -> tuple[queue.Queue[Reply], Callable[[], bool]]:
    replies: queue.Queue[Reply] = queue.Queue()
    return replies, profiling.call(seconds, "tcp:me 1", replies.put)


def is_watched(rig: Rig) -> bool:
    """After all that was asked so far."""
    found: queue.Queue[bool] = queue.Queue()
    rig.simulation.steer(lambda: found.put(rig.world._profile is not None), "tcp:me 1")
    return found.get(timeout=PATIENCE_S)


def test_a_call_is_answered_when_its_seconds_are_over(still: Rig) -> None:
    later = Later()
    profiling = profiling_of(still, later)
    assert not is_watched(still)
    replies, cancel = ask(profiling)
    seconds, end = later.take()
    assert seconds == 2.0
    assert is_watched(still)
    still.call("world/step", n=24)
    assert replies.empty()
    still.soon(end)
    reply = replies.get(timeout=PATIENCE_S)
    assert (reply.fault, reply.tick, reply.result["ticks"]) == (None, 24, 24)
    told = {(line["stage"], line["what"]): line for line in reply.result["lines"]}
    assert told["physics", "bodies"]["calls"] == told["publishing", "to the loop"]["calls"] == 24
    assert told["physics", "bodies"]["mean_us"] > 0.0
    assert not is_watched(still)
    assert not cancel(), "it is answered"
    assert replies.empty()


def test_two_measure_at_once_and_the_last_one_ends_it(still: Rig) -> None:
    later = Later()
    profiling = profiling_of(still, later)
    first, _ = ask(profiling)
    _, end_first = later.take()
    still.call("world/step", n=10)
    second, _ = ask(profiling)
    _, end_second = later.take()
    still.call("world/step", n=5)
    still.soon(end_first)
    assert first.get(timeout=PATIENCE_S).result["ticks"] == 15
    assert is_watched(still)
    still.soon(end_second)
    assert second.get(timeout=PATIENCE_S).result["ticks"] == 5
    assert not is_watched(still)


def test_who_cancels_is_answered_once(still: Rig) -> None:
    later = Later()
    replies, cancel = ask(profiling_of(still, later))
    assert cancel()
    assert not cancel()
    assert replies.get(timeout=PATIENCE_S).fault.code == "preempted"
    _, end = later.take()
    still.soon(end)
    assert not is_watched(still)
    assert replies.empty()


def test_no_more_than_so_many_measure_at_once(still: Rig) -> None:
    profiling = profiling_of(still)
    for _ in range(MAX_MEASUREMENTS):
        ask(profiling)
    with pytest.raises(Refused, match=f"{MAX_MEASUREMENTS} profiles"):
        ask(profiling)


def test_the_end_of_the_run_answers_who_waits(resolved) -> None:
    with running(resolved, Timing(paused=True)) as rig:
        profiling = profiling_of(rig)
        replies, _ = ask(profiling)
        rig.call("world/step", n=6)
    assert replies.empty()
    late, _ = ask(profiling)  # there is no thread any more that would begin it
    profiling.finish()
    assert replies.get_nowait().result["ticks"] == 6
    assert late.get_nowait().result["ticks"] == 0
    profiling.finish()
    assert replies.empty()


def test_who_is_told_at_the_end_of_the_run_is_told_once(still: Rig) -> None:
    later, gate, over = Later(), threading.Event(), threading.Event()
    profiling = profiling_of(still, later)
    replies, _ = ask(profiling)
    _, end = later.take()
    still.call("world/step", n=3)
    still.soon(end)
    still.soon(lambda: gate.wait(PATIENCE_S) and None)
    while is_watched(still):  # its end is carried out by the simulation, and waits for the loop
        pass
    profiling.finish()
    assert replies.get_nowait().result["ticks"] == 3
    gate.set()
    still.soon(over.set)
    assert over.wait(PATIENCE_S)
    assert replies.empty()


def test_tables_come_every_so_many_seconds_and_at_the_end(resolved) -> None:
    told: queue.Queue[str] = queue.Queue()
    later = Later()
    with running(resolved, Timing(paused=True)) as rig:
        profiling = profiling_of(rig, later)
        profiling.tell_every(10.0, told.put)
        for ticks in (12, 24):
            seconds, end = later.take()
            assert seconds == 10.0
            rig.call("world/step", n=ticks)
            rig.soon(end)
            assert told.get(timeout=PATIENCE_S).startswith(f"profile of {ticks} ticks")
        later.take()
        rig.call("world/step", n=4)
    profiling.finish()
    assert told.get_nowait().startswith("the whole run: profile of 40 ticks")
    assert told.empty()


def test_the_service_says_its_limits() -> None:
    (seconds,) = PROFILE.arguments
    assert PROFILE.long_running
    assert (seconds.default, seconds.minimum, seconds.maximum) == (1.0, 0.01, 3600.0)
