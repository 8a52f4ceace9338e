"""Work on a thread, told on the loop in its order."""

from __future__ import annotations

import asyncio
import threading

from uwserver.adapter import AdapterStats, InOrder
from uwserver.adapter.threads import MOST

PATIENCE_S = 20


def test_results_come_on_the_loop_in_the_order_of_the_work() -> None:
    async def story() -> None:
        told: list[tuple[int | None, str]] = []
        line = InOrder[int]("a thread", AdapterStats())
        gate, over = threading.Event(), asyncio.Event()

        def work(number: int) -> int:
            if number == 0:
                assert gate.wait(PATIENCE_S)
            assert threading.current_thread() is not threading.main_thread()
            return number

        def done(number: int | None) -> None:
            told.append((number, threading.current_thread().name))
            if number == MOST - 1:
                over.set()

        for number in range(MOST):
            line.put(lambda number=number: work(number), done)  # type: ignore[misc]
        assert told == []
        gate.set()
        await asyncio.wait_for(over.wait(), PATIENCE_S)
        assert told == [(number, threading.main_thread().name) for number in range(MOST)]
        await line.close()

    asyncio.run(story())


def test_who_brings_too_many_waits_for_the_oldest_and_loses_none() -> None:
    async def story() -> None:
        told: list[int | None] = []
        line = InOrder[int]("a thread", AdapterStats())
        for number in range(3 * MOST):
            line.put(lambda number=number: number, told.append)  # type: ignore[misc]
        assert len(told) >= 2 * MOST, "without a turn of the loop"
        while len(told) < 3 * MOST:
            await asyncio.sleep(0)
        assert told == list(range(3 * MOST))
        await line.close()

    asyncio.run(asyncio.wait_for(story(), PATIENCE_S))


def test_what_fails_is_counted_and_told_as_nothing() -> None:
    async def story() -> None:
        told: list[int | None] = []
        stats = AdapterStats()
        line = InOrder[int]("a thread", stats)
        line.put(lambda: 1 // 0, told.append)
        line.put(lambda: 7, told.append)
        while len(told) < 2:
            await asyncio.sleep(0)
        assert (told, stats.errors) == ([None, 7], 1)
        await line.close()

    asyncio.run(asyncio.wait_for(story(), PATIENCE_S))


def test_the_end_leaves_no_thread_and_tells_nothing() -> None:
    async def story() -> None:
        told: list[int | None] = []
        line = InOrder[int]("a thread of the end", AdapterStats())
        gate = threading.Event()
        line.put(lambda: int(gate.wait(PATIENCE_S)), told.append)
        line.put(lambda: 2, told.append)
        asyncio.get_running_loop().call_later(0.01, gate.set)
        await line.close()
        await asyncio.sleep(0.01)
        assert told == []
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("a thread of the end")]

    asyncio.run(asyncio.wait_for(story(), PATIENCE_S))
