"""Waiting that ends in time, and loses no cancellation."""

from __future__ import annotations

import asyncio

import pytest

from uwserver.adapter import within


def test_an_answer_in_time() -> None:
    async def answer() -> int:
        await asyncio.sleep(0)
        return 7

    assert asyncio.run(within(5.0, answer(), "no answer")) == 7


def test_what_takes_too_long_is_ended() -> None:
    ended: list[bool] = []

    async def never() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append(True)

    with pytest.raises(TimeoutError, match=r"no answer in 0\.01 s"):
        asyncio.run(within(0.01, never(), "no answer"))
    assert ended == [True]


def test_a_fault_of_what_is_waited_for_is_told() -> None:
    async def fail() -> None:
        raise ConnectionResetError("gone")

    with pytest.raises(ConnectionResetError, match="gone"):
        asyncio.run(within(5.0, fail(), "no answer"))


def test_a_cancellation_that_comes_with_the_answer_counts() -> None:
    async def main() -> bool:
        answered: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        task = asyncio.ensure_future(within(5.0, answered, "no answer"))
        await asyncio.sleep(0)
        answered.set_result(None)
        task.cancel()
        await asyncio.wait([task])
        return task.cancelled()

    assert asyncio.run(main())
