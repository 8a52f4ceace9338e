"""What is done in pieces: in order, with rests in which others have their turn, whatever fails."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from uwserver.adapter import BackgroundWork, InputTurns, turns


def _steps(said: list[str], name: str, count: int) -> Iterator[None]:
    for number in range(count):
        said.append(f"{name}{number}")
        yield


def test_one_after_the_other_with_turns_of_others_between(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "TURN_S", 0.0)
    monkeypatch.setattr(turns, "REST_S", 0.0)

    async def scene() -> None:
        said: list[str] = []
        jobs = BackgroundWork()
        jobs.add(_steps(said, "a", 3))
        jobs.add(_steps(said, "b", 2))
        assert said == [], "not before its turn"
        turns = 0
        while len(jobs):
            await asyncio.sleep(0)
            turns += 1
        assert said == ["a0", "a1", "a2", "b0", "b1"]
        assert turns >= 5
        jobs.add(_steps(said, "c", 1))
        while len(jobs):
            await asyncio.sleep(0)
        assert said[-1] == "c0"

    asyncio.run(scene())


def test_a_fault_ends_only_that_one(caplog: pytest.LogCaptureFixture) -> None:
    def bad() -> Iterator[None]:
        yield
        raise RuntimeError("oh")

    async def scene() -> None:
        said: list[str] = []
        jobs = BackgroundWork()
        jobs.add(bad())
        jobs.add(_steps(said, "a", 1))
        while len(jobs):
            await asyncio.sleep(0)
        assert said == ["a0"]

    asyncio.run(scene())
    assert "oh" in caplog.text


def test_closed_it_does_nothing_more() -> None:
    async def scene() -> None:
        said: list[str] = []
        jobs = BackgroundWork()
        jobs.add(_steps(said, "a", 1))
        jobs.close()
        await asyncio.sleep(0.01)
        assert said == []
        assert len(jobs) == 0

    asyncio.run(scene())


def test_input_is_handled_in_turns_and_nothing_is_read_in_a_rest(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(turns, "TURN_S", 0.0)
    monkeypatch.setattr(turns, "REST_S", 0.0)

    async def scene() -> None:
        stored, life = [1, 2], []

        def step() -> bool:
            life.append("step")
            return bool(stored) and bool(stored.pop())

        taking = InputTurns(step, lambda: life.append("pause"), lambda: life.append("resume"))
        taking.begin()
        taking.begin()
        assert life == ["step", "pause"]
        while "resume" not in life:
            await asyncio.sleep(0)
        assert life == ["step", "pause", "step", "pause", "step", "resume"]
        stored.append(3)
        taking.begin()
        taking.stop()
        await asyncio.sleep(0.01)
        assert life[6:] == ["step", "pause"]

    asyncio.run(scene())
