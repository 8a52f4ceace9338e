"""Two threads hand the interpreter to each other: each gets it, nobody waits for one that does not come, and sockets are waited for meanwhile.

Also of uwserver.physics.kernel.giving_way.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from uwserver.physics.kernel.places import ANSWERED, ASKED, AWAKE, CALLED, FUTEX, GIVEN, HEARD, RUNS
from uwserver.physics.kernel.right_of_way import MOST_CREDIT_NS, RightOfWay

pytestmark = pytest.mark.skipif(not FUTEX, reason="threads wait in compiled code on Linux alone")


@pytest.fixture
def way() -> RightOfWay:
    return RightOfWay()


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, theirs = socket.socketpair()
    yield ours, theirs
    ours.close()
    theirs.close()


def readable(way: RightOfWay, pair: tuple[socket.socket, socket.socket]) -> int:
    """Let the loop wait for something that is there already; returns what it asks with."""
    pair[1].send(b"x")
    way.sleep(pair[0].fileno(), None)
    return int(way.numbers[ASKED])


def test_it_sleeps_until_something_can_be_read_or_the_time_is_over(
    way: RightOfWay, pair: tuple[socket.socket, socket.socket]
) -> None:
    for turn, seconds in enumerate((0.0, 1e-6, 0.003), 1):
        way.sleep(pair[0].fileno(), seconds)
        assert way.numbers[ASKED] == 1 + 2 * turn
    assert readable(way, pair) == 9
    thread = threading.Timer(0.05, pair[1].send, (b"later",))
    thread.start()
    pair[0].recv(1)
    way.sleep(pair[0].fileno(), None)
    assert pair[0].recv(5) == b"later"
    thread.join()


def test_who_gives_way_where_nobody_asks_does_nothing(
    way: RightOfWay, pair: tuple[socket.socket, socket.socket]
) -> None:
    """And does not wait: the loop is away until something comes, and nothing does before the ticks are done."""
    way.numbers[ASKED] = 2
    for _ in range(1000):
        way.give()
    assert (way.numbers[GIVEN], way.numbers[RUNS]) == (0, 1)
    way.rest()
    assert way.numbers[RUNS] == 0


def test_a_loop_that_keeps_the_interpreter_is_waited_for_once(
    way: RightOfWay, monkeypatch: pytest.MonkeyPatch, pair: tuple[socket.socket, socket.socket]
) -> None:
    given: list[int] = []
    real = way._give_way
    monkeypatch.setattr(way, "_give_way", lambda numbers: (given.append(int(numbers[ASKED])), real(numbers))[1])
    for _ in range(5):
        way.give()
    assert given == [1]
    way.rest()
    asked = readable(way, pair)
    for _ in range(5):
        way.give()
    assert given == [1, asked], "it has gone and come again"


def test_a_loop_that_is_always_at_work_has_half_of_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A peer may flood it: then the world goes on as it does beside any other thread of Python."""
    now = 0
    way = RightOfWay(lambda: now)
    ticks = given = 0

    def give_way(numbers: np.ndarray) -> int:
        nonlocal now, given
        given += 1
        now += 100_000
        numbers[ASKED] += 2  # it asks again at once
        return 0

    monkeypatch.setattr(way, "_give_way", give_way)
    while ticks < 10_000:
        way.give()
        ticks += 1
        now += 10_000
    assert given == pytest.approx((MOST_CREDIT_NS + 10_000 * ticks) / 100_000, rel=0.02)
    now += 10 * MOST_CREDIT_NS
    given = 0
    while given == ticks - 10_000:
        way.give()
        ticks += 1
    assert given == pytest.approx(MOST_CREDIT_NS / 100_000, abs=1), "what was saved is bounded"


def test_the_loop_does_not_wait_for_long_for_a_tick_that_does_not_end(
    way: RightOfWay, pair: tuple[socket.socket, socket.socket]
) -> None:
    way.numbers[RUNS] = 1
    assert readable(way, pair) == 3
    assert way.send(pair[0].fileno(), b"abc") == 3
    assert pair[1].recv(10) == b"abc"


def test_each_has_the_interpreter_in_turn(way: RightOfWay, pair: tuple[socket.socket, socket.socket]) -> None:
    """Ticks go on while the loop waits, and stand while it works; it comes back each time."""
    ours, theirs = pair
    heard, ended = [], threading.Event()

    def loop() -> None:
        while True:
            way.sleep(ours.fileno(), 1.0)
            data = ours.recv(100)
            heard.append(data)
            if b"end" in data:
                way.numbers[ASKED] += 1  # it needs the interpreter no more
                ended.set()
                return
            way.send(ours.fileno(), data)

    thread = threading.Thread(target=loop)
    thread.start()
    ticks = 0
    theirs.setblocking(False)
    for turn in range(200):
        theirs.send(b"%d" % turn)
        while True:
            way.give()
            ticks += 1
            try:
                assert theirs.recv(100) == b"%d" % turn
                break
            except BlockingIOError:
                continue
    theirs.send(b"end")
    while not ended.is_set():
        way.give()
    way.rest()
    thread.join(30.0)
    assert heard == [*(b"%d" % turn for turn in range(200)), b"end"]
    assert ticks >= 200


def asleep(way: RightOfWay, pair: tuple[socket.socket, socket.socket]) -> threading.Thread:
    """A loop that waits for the other end."""
    thread = threading.Thread(target=way.sleep, args=(pair[0].fileno(), 30.0))
    thread.start()
    return thread


def test_who_answers_a_loop_that_has_called_need_not_wake_it(
    way: RightOfWay, pair: tuple[socket.socket, socket.socket]
) -> None:
    way.numbers[RUNS] = 1
    answered, turn, last = False, 0, time.monotonic() + 60.0
    while not answered and time.monotonic() < last:  # until this thread has come in time, on a machine with other work
        turn += 1
        way.wake.set()
        thread = asleep(way, pair)
        end = time.monotonic() + 30.0
        while way.numbers[HEARD] != turn and time.monotonic() < end:
            pass
        while way.numbers[AWAKE] and not answered:
            answered = way.answer()
        if not answered:
            pair[1].send(b"x")
        thread.join(30.0)
        assert not thread.is_alive(), "nothing was sent to it"
        if not answered:
            pair[0].recv(1)
    assert answered
    assert way.numbers[AWAKE] == way.numbers[ANSWERED] == 0


def test_a_loop_stays_awake_once_for_each_call_and_only_where_a_world_runs(
    way: RightOfWay, pair: tuple[socket.socket, socket.socket]
) -> None:
    assert not way.answer(), "it has the interpreter: whoever has something for it must say so as ever"
    way.wake.set()
    way.sleep(pair[0].fileno(), 0.001)
    assert way.numbers[HEARD] == 0, "nobody runs, who would answer at once"
    way.numbers[RUNS] = 1
    way.sleep(pair[0].fileno(), 0.001)
    assert way.numbers[HEARD] == way.numbers[CALLED] == 1
    thread = asleep(way, pair)
    assert not way.answer(), "nobody was called since: it sleeps"
    pair[1].send(b"x")
    thread.join(30.0)
    assert not thread.is_alive()


def test_an_answer_that_comes_before_it_is_waited_for_ends_the_wait(
    way: RightOfWay, pair: tuple[socket.socket, socket.socket]
) -> None:
    """One that was meant for the last wait, and came late: the loop looks once for nothing."""
    way.numbers[RUNS] = way.numbers[ANSWERED] = 1
    way.wake.set()
    way.sleep(pair[0].fileno(), None)
    assert way.numbers[ANSWERED] == 0


def test_who_sends_something_to_a_loop_that_is_awake_is_heard(
    way: RightOfWay, pair: tuple[socket.socket, socket.socket]
) -> None:
    way.numbers[RUNS] = 1
    way.wake.set()
    pair[1].send(b"x")
    way.sleep(pair[0].fileno(), None)
    assert pair[0].recv(1) == b"x"


def test_a_full_socket_takes_what_it_can_and_a_lost_one_nothing(
    way: RightOfWay, pair: tuple[socket.socket, socket.socket]
) -> None:
    ours, theirs = pair
    much = np.random.default_rng(1).bytes(1 << 22)
    taken = way.send(ours.fileno(), much)
    assert 0 < taken < len(much)
    assert way.send(ours.fileno(), b"more") == 0
    assert theirs.recv(taken, socket.MSG_WAITALL) == much[:taken]
    theirs.close()
    assert way.send(ours.fileno(), b"more") == 0, "no signal ends the process"
    assert way.send(ours.fileno(), b"") == 0
