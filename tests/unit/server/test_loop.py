"""The loop of a server is asyncio's selector loop on every system."""

from __future__ import annotations

import asyncio
import socket
import sys

import pytest

from uwserver.server.loop import run


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
