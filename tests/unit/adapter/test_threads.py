"""What crosses between the loop and the threads of a library: bounded, in order, and nothing is left behind."""

from __future__ import annotations

import asyncio
import threading
from itertools import pairwise

import pytest

from uwserver.adapter import AdapterStats, Inbox, Worker, threads


async def until(condition) -> None:
    while not condition():
        await asyncio.sleep(0.001)


def test_an_inbox_keeps_the_order_and_refuses_what_is_too_much():
    async def scene() -> None:
        taken: list[int] = []
        refused: list[int] = []
        inbox = Inbox(taken.append, 3, refused.append)
        foreign = threading.Thread(target=lambda: [inbox.put(number) for number in range(5)])
        foreign.start()
        foreign.join()
        assert taken == [], "only the loop takes"
        await until(lambda: taken)
        inbox.put(9)
        await until(lambda: 9 in taken)
        assert taken == [0, 1, 2, 9]
        assert refused == [3, 4]

    asyncio.run(scene())


def test_an_inbox_is_bounded_in_bytes_too():
    async def scene() -> None:
        taken: list[bytes] = []
        refused: list[bytes] = []
        inbox = Inbox(taken.append, 100, refused.append, len, 10)
        for item in (b"a" * 50, b"b"):
            inbox.put(item)
        assert refused == [b"b"], "one may be larger, and then no other waits"
        await until(lambda: len(taken) == 1)
        for item in (b"c" * 6, b"d" * 5, b"e" * 4):
            inbox.put(item)
        await until(lambda: len(taken) == 3)
        assert (taken[1:], refused[1:]) == ([b"c" * 6, b"e" * 4], [b"d" * 5])

    asyncio.run(scene())


def test_an_inbox_takes_a_bounded_time_of_a_turn(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(threads, "TURN_S", 0.0)

    async def scene() -> None:
        loop, order = asyncio.get_running_loop(), list[object]()
        inbox = Inbox(order.append, 10, lambda _: None)
        for number in range(3):
            inbox.put(number)
        for other in "abc":
            loop.call_soon(order.append, other)
            await asyncio.sleep(0)
        await until(lambda: 2 in order)
        assert [item for item in order if isinstance(item, int)] == [0, 1, 2]
        assert order.index("b") < order.index(2), "others have had their turn"

    asyncio.run(scene())


def test_an_inbox_rests_when_a_turn_is_used_up(monkeypatch: pytest.MonkeyPatch):
    """A flood had the loop without a pause, and the interpreter half of the time."""
    monkeypatch.setattr(threads, "TURN_S", 0.0)

    async def scene() -> None:
        loop = asyncio.get_running_loop()
        at: list[float] = []
        inbox = Inbox(lambda _: at.append(loop.time()), 10, lambda _: None)
        for number in range(5):
            inbox.put(number)
        await until(lambda: len(at) == 5)
        assert min(after - before for before, after in pairwise(at)) > threads.REST_S / 2

    asyncio.run(scene())


def test_an_inbox_survives_a_fault_of_who_takes(caplog: pytest.LogCaptureFixture):
    async def scene() -> None:
        taken: list[int] = []

        def take(number: int) -> None:
            taken.append(number)
            if number == 0:
                raise ValueError("of the test")

        inbox = Inbox(take, 10, lambda _: None)
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)
        inbox.put(0)
        inbox.put(1)
        await until(lambda: 1 in taken)

    asyncio.run(scene())


def test_an_inbox_outlives_its_loop():
    async def scene() -> Inbox[int]:
        return Inbox(lambda _: None, 3, lambda _: None)

    asyncio.run(scene()).put(1)


def test_a_worker_works_in_order_and_counts_what_fails_or_is_too_much(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(threads, "WAITING", 2)

    async def scene() -> None:
        stats, done = AdapterStats(), []
        gate = threading.Event()
        worker = Worker("a test's worker", stats)
        assert worker.send(gate.wait)
        assert worker.send(lambda: done.append(threading.current_thread().name))
        assert not worker.send(lambda: done.append("too much"))
        assert stats.dropped == 1
        gate.set()
        await until(lambda: done)
        assert done[0].startswith("a test's worker")
        assert worker.send(lambda: 1 / 0)
        assert await worker.run(lambda: 7) == 7
        assert stats.errors == 1
        await worker.close(lambda: done.append("closed"))
        assert done[-1] == "closed"

    asyncio.run(scene())


def test_cancelled_work_still_ends_first():
    async def scene() -> None:
        worker, begun, gate, done = Worker("worker", AdapterStats()), threading.Event(), threading.Event(), []

        def work() -> None:
            begun.set()
            gate.wait(60)
            done.append(True)

        task = asyncio.create_task(worker.run(work))
        await until(begun.is_set)
        task.cancel()
        await asyncio.sleep(0.01)
        assert not task.done()
        gate.set()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert done
        await worker.close(lambda: None)

    asyncio.run(scene())
