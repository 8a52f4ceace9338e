"""The loop of a server, and the signals that end it."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
from collections.abc import Iterator

import pytest

from uwserver.server.process import run, signals_received


@pytest.mark.parametrize("platform", ["linux", "win32"])
def test_the_loop_can_watch_a_listener_and_leaves_no_task(platform: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[str] = []
    policies: list[object] = []
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(asyncio, "WindowsSelectorEventLoopPolicy", lambda: "selectors", raising=False)
    monkeypatch.setattr(asyncio, "set_event_loop_policy", policies.append)

    async def waits() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append("cancelled")

    async def main() -> str:
        ours, theirs = socket.socketpair()
        heard = asyncio.Event()
        asyncio.get_running_loop().add_reader(ours, heard.set)
        theirs.send(b"x")
        await asyncio.wait_for(heard.wait(), 10.0)
        asyncio.get_running_loop().remove_reader(ours)
        ours.close()
        theirs.close()
        tasks.append(asyncio.create_task(waits()))
        await asyncio.sleep(0)
        return "done"

    tasks: list[asyncio.Task[None]] = []
    assert run(main()) == "done"
    assert policies == (["selectors"] if platform == "win32" else [])
    assert ended == ["cancelled"]
    assert tasks[0].cancelled()


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


async def _told(*numbers: signal.Signals) -> list[signal.Signals]:
    """What is told while it listens, which ends with the first that is."""
    told: list[signal.Signals] = []
    with signals_received(asyncio.get_running_loop(), told.append):
        for number in numbers:
            signal.raise_signal(number)
        while len(told) < len(numbers):
            await asyncio.sleep(0.001)
    return told


def _refuse(*args: object) -> None:
    raise NotImplementedError


@pytest.fixture(params=[True, False], ids=["posix", "as on windows"])
def loop(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[asyncio.AbstractEventLoop]:
    loop = asyncio.new_event_loop()
    if not request.param:
        monkeypatch.setattr(loop, "add_signal_handler", _refuse)
        monkeypatch.setattr(loop, "remove_signal_handler", _refuse)
    yield loop
    loop.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_told_and_again_while_who_was_asked_to_end_does(
    number: signal.Signals, loop: asyncio.AbstractEventLoop
) -> None:
    told = loop.run_until_complete(_told(number))
    assert told == [number]
    loop.close()
    for again in (signal.SIGTERM, signal.SIGINT):
        signal.raise_signal(again)
    assert told == [number, signal.SIGTERM, signal.SIGINT]


def test_without_one_the_handlers_before_come_back(loop: asyncio.AbstractEventLoop) -> None:
    before = []
    for number in (signal.SIGINT, signal.SIGTERM):
        before.append(lambda caught, frame: None)
        signal.signal(number, before[-1])
    assert loop.run_until_complete(_told()) == []
    loop.close()
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
