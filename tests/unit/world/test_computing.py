"""Jobs: one at a time, in their order, at most once; what fails; and the end of the thread."""

from __future__ import annotations

import gc
import threading
import time

from uwserver.ports import Value
from uwserver.sensors.job import Job
from uwserver.world.computing import Computing, settled

PATIENCE_S = 30.0


class Noted(Job):
    """Tells when it runs, and waits for a gate."""

    def __init__(self, notes: list[str], name: str, gate: threading.Event | None = None) -> None:
        self.notes, self.name, self.gate = notes, name, gate

    def run(self) -> tuple[Value, ...]:
        self.notes.append(f"{self.name} begins")
        assert self.gate is None or self.gate.wait(PATIENCE_S)
        self.notes.append(f"{self.name} ends")
        return (self.name,)


def test_jobs_that_are_due_together_run_one_after_the_other_in_their_order_and_once() -> None:
    computing, notes, gate = Computing(), list[str](), threading.Event()
    works = [computing.work(Noted(notes, name, gate), (None,)) for name in "abc"]
    for work in works:
        computing.begin(work, 0)
    assert not works[0].is_done
    gate.set()
    assert [settled(work) for work in (*works, works[0])] == [("a",), ("b",), ("c",), ("a",)]
    assert notes == [f"{name} {what}" for name in "abc" for what in ("begins", "ends")]
    computing.end()


def test_who_is_due_first_goes_first() -> None:
    """A sonar that waited behind the picture of a camera, which had more time, lost all its pings."""
    computing, notes, gate = Computing(), list[str](), threading.Event()
    due = {"running": 0, "camera": 170, "sonar": 73}
    works = {name: computing.work(Noted(notes, name, gate), (None,)) for name in due}
    for name, work in works.items():
        computing.begin(work, due[name])
    gate.set()
    deadline = time.monotonic() + PATIENCE_S
    while not all(work.is_done for work in works.values()) and time.monotonic() < deadline:
        time.sleep(0.001)
    computing.end()
    assert notes in ([f"{name} {what}" for name in ("running", "sonar", "camera") for what in ("begins", "ends")],)


def test_who_needs_what_the_thread_will_not_do_does_it() -> None:
    computing, notes = Computing(), list[str]()
    work = computing.work(Noted(notes, "a"), (None,))
    assert work.result() == ("a",)
    assert computing.work(Noted(notes, "b"), (None, None)).result() == (None, None)  # one value is not two


def test_a_cancelled_job_is_left_out() -> None:
    computing, notes, gate = Computing(), list[str](), threading.Event()
    first, other, last = (computing.work(Noted(notes, name, gate), (None,)) for name in "abc")
    for work in (first, other, last):
        computing.begin(work, 0)
    other.is_cancelled = True
    gate.set()
    assert last.result() == ("c",)
    assert "b begins" not in notes
    assert other.result() == ("b",)  # as in a state that was kept
    computing.end()


def test_the_end_waits_for_the_job_under_way_alone_and_a_new_one_begins_anew() -> None:
    computing, notes, gate = Computing(), list[str](), threading.Event()
    gate.set()
    for name in "ab":
        computing.begin(computing.work(Noted(notes, name, gate), (None,)), 0)
    computing.end()
    computing.end()
    assert notes in ([], ["a begins", "a ends"], ["a begins", "a ends", "b begins", "b ends"])
    work = computing.work(Noted(notes, "c"), (None,))
    computing.begin(work, 0)
    assert work.result() == ("c",)
    computing.end()


def test_a_forgotten_world_lets_its_thread_go() -> None:
    computing, before = Computing(), set(threading.enumerate())
    computing.begin(computing.work(Noted([], "a"), (None,)), 0)
    (thread,) = set(threading.enumerate()) - before
    del computing
    gc.collect()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def test_a_failure_is_kept_as_text_and_blank_values() -> None:
    class Torn(Job):
        def run(self) -> tuple[Value, ...]:
            raise ValueError("torn")

    work = Computing().work(Torn(), (None, None))
    assert (work.result(), work.error) == ((None, None), "ValueError: torn")
    assert work.is_done


def test_processor_time_of_a_wait_is_none() -> None:
    computing, gate = Computing(), threading.Event()
    work = computing.work(Noted([], "a", gate), (None,))
    computing.begin(work, 0)
    threading.Timer(0.2, gate.set).start()
    before = time.thread_time()
    assert work.result() == ("a",)
    assert time.thread_time() - before < 0.1
    computing.end()
