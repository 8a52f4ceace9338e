"""Signals reach the server on loops that know them, and on those that do not."""

from __future__ import annotations

import asyncio
import signal
import socket

import pytest

from uwserver.server.signals import run, signals_received


async def _told(number: signal.Signals) -> list[signal.Signals]:
    told: list[signal.Signals] = []
    with signals_received(asyncio.get_running_loop(), told.append):
        signal.raise_signal(number)
        for _ in range(100):
            await asyncio.sleep(0.001)
            if told:
                break
    return told


def _refuse(*args: object) -> None:
    raise NotImplementedError


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("knows", [True, False], ids=["posix", "as on windows"])
def test_a_signal_is_told_and_the_handler_before_comes_back(
    number: signal.Signals, knows: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = signal.getsignal(number)
    loop = asyncio.new_event_loop()
    if not knows:
        monkeypatch.setattr(loop, "add_signal_handler", _refuse)
        monkeypatch.setattr(loop, "remove_signal_handler", _refuse)
    try:
        assert loop.run_until_complete(_told(number)) == [number]
    finally:
        loop.close()
    assert signal.getsignal(number) in (before, signal.SIG_DFL, signal.default_int_handler)


@pytest.mark.parametrize("platform", ["linux", "win32"])
def test_the_loop_can_watch_a_listener_and_leaves_no_task(platform: str) -> None:
    ended: list[str] = []

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
    assert run(main(), platform) == "done"
    assert ended == ["cancelled"]
    assert tasks[0].cancelled()
