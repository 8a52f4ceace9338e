"""Jobs: one at a time, in their order, at most once; what fails; and the end of the thread."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable

from uwserver.ports import Value
from uwserver.sensors.job import Job, Pieces, whole
from uwserver.world.sensing.computing import Computing, Work, wait_for_values

PATIENCE_S = 120.0


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
    assert [wait_for_values(work) for work in (*works, works[0])] == [("a",), ("b",), ("c",), ("a",)]
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


class InPieces(Job):
    """Three pieces; tells which it does, and lets a test act in the middle of one."""

    def __init__(
        self, notes: list[str], name: str, shared: object = None, during: Callable[[int], None] | None = None
    ) -> None:
        self.notes, self.name, self.during, self.shared = notes, name, during, shared

    def run(self) -> tuple[Value, ...]:
        return whole(self.pieces())

    def pieces(self) -> Pieces[tuple[Value, ...]]:
        for k in range(3):
            self.notes.append(f"{self.name}{k}")
            if self.during is not None:
                self.during(k)
            yield
        return (self.name,)


def order_of(begun: dict[str, tuple[int, object]], cancelled: str = "") -> list[str]:
    """What is done when, where a picture that is due at 100 is at its second piece when others begin: by name, their times, and what they share."""
    computing, notes, works = Computing(), list[str](), dict[str, Work]()

    def during(piece: int) -> None:
        if piece == 1:
            for name, (due, shared) in begun.items():
                works[name] = computing.work(InPieces(notes, name, shared), (None,))
                works[name].is_cancelled = name == cancelled
                computing.begin(works[name], due)

    picture = computing.work(InPieces(notes, "picture", "camera", during), (None,))
    computing.begin(picture, 100)
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline and not (
        picture.is_done and all(work.is_done or work.is_cancelled for work in works.values())
    ):
        time.sleep(0.001)
    computing.end()
    assert picture.result() == ("picture",)
    return [note for note in notes if note[-1] == "0" or note.startswith("picture")]


def test_a_ping_that_is_due_before_a_picture_runs_between_its_pieces() -> None:
    order = order_of({"late": (101, None), "soon": (73, None), "sooner": (72, None)})
    assert order == ["picture0", "picture1", "sooner0", "soon0", "picture2", "late0"]


def test_no_two_jobs_that_share_arrays_are_under_way_at_once() -> None:
    assert order_of({"again": (50, "camera")}) == ["picture0", "picture1", "picture2", "again0"]


def test_one_that_comes_to_the_front_as_another_is_looked_at_waits_too_for_arrays_that_it_shares() -> None:
    """After a reset a camera's next picture may be due long before the one under way."""
    computing, notes = Computing(), list[str]()

    class Watched(InPieces):
        """The simulation thread begins the camera's next job just when this one is asked what it shares."""

        @property
        def shared(self) -> object:
            if not again.is_begun:
                computing.begin(again, 10)
            return None

        @shared.setter
        def shared(self, _: object) -> None:
            pass

    again = computing.work(InPieces(notes, "again", "camera"), (None,))
    ping = computing.work(Watched(notes, "ping"), (None,))

    def during(piece: int) -> None:
        if piece == 0:
            computing.begin(ping, 50)

    picture = computing.work(InPieces(notes, "picture", "camera", during), (None,))
    computing.begin(picture, 100)
    deadline = time.monotonic() + PATIENCE_S
    while not (picture.is_done and ping.is_done and again.is_done) and time.monotonic() < deadline:
        time.sleep(0.001)
    computing.end()
    assert [note for note in notes if note[-1] in "02"] == [
        "picture0", "ping0", "ping2", "picture2", "again0", "again2",
    ]  # fmt: skip


def test_what_is_cancelled_is_left_out_between_pieces_too() -> None:
    assert order_of({"lost": (50, None), "ping": (60, None)}, "lost") == ["picture0", "picture1", "ping0", "picture2"]


def test_a_failure_between_the_pieces_of_another_is_its_own() -> None:
    class Torn(Job):
        def run(self) -> tuple[Value, ...]:
            notes.append("torn")
            raise IndexError("torn")

    computing, works, notes = Computing(), list[Work](), list[str]()

    def during(piece: int) -> None:
        if piece == 0:
            works.append(computing.work(Torn(), (None,)))
            computing.begin(works[0], 1)

    picture = computing.work(InPieces(notes, "picture", None, during), (None,))
    computing.begin(picture, 100)
    deadline = time.monotonic() + PATIENCE_S
    while not picture.is_done and time.monotonic() < deadline:
        time.sleep(0.001)
    assert notes == ["picture0", "torn", "picture1", "picture2"]
    assert (works[0].result(), works[0].error, picture.result()) == ((None,), "IndexError: torn", ("picture",))
    computing.end()
