"""The loop of a server does what asyncio's own does, also where it waits by a right of way."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading

import pytest

from uwserver.physics.kernel.places import ASKED, HEARD, RUNS
from uwserver.physics.kernel.team import why_alone
from uwserver.server import loop as server_loop
from uwserver.server.loop import ServerLoop, begin_way, run


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


needs_two = pytest.mark.skipif(bool(why_alone()), reason="a right of way needs Linux and two cores")


@needs_two
@pytest.mark.parametrize("is_stepping", [False, True], ids=["idle", "stepping"])
def test_all_that_a_loop_waits_for_still_comes(is_stepping: bool) -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        way = begin_way(loop)
        assert way is not None
        way.numbers[RUNS] = is_stepping  # whose ticks never end: nobody is waited for without an end
        begin = loop.time()
        await asyncio.sleep(0.02)
        assert loop.time() - begin >= 0.02
        called = loop.create_future()
        threading.Thread(target=lambda: loop.call_soon_threadsafe(called.set_result, "called")).start()
        assert await called == "called"
        server = await asyncio.start_server(lambda r, w: asyncio.ensure_future(echo(r, w)), "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        for turn in range(20):
            writer.write(b"%d\n" % turn)
            assert await reader.readline() == b"%d\n" % turn
        writer.close()
        server.close()
        assert await loop.run_in_executor(None, lambda: 7) == 7
        signalled = asyncio.Event()
        loop.add_signal_handler(signal.SIGUSR1, signalled.set)
        threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGUSR1)).start()
        await signalled.wait()
        loop.remove_signal_handler(signal.SIGUSR1)
        assert way.numbers[ASKED] > 40

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            writer.write(line)
        writer.close()

    run(asyncio.wait_for(main(), 30.0))


@needs_two
def test_a_loop_that_has_called_hears_each_answer() -> None:
    """At once or a little late, awake or asleep: none is lost."""

    async def main() -> None:
        loop, heard, called = asyncio.get_running_loop(), asyncio.Event(), threading.Semaphore(0)
        way = begin_way(loop)
        assert way is not None
        way.numbers[RUNS] = 1

        def answer() -> None:
            for turn in range(500):
                called.acquire()
                for _ in range(300 * (turn % 4)):
                    pass
                loop.call_soon_threadsafe(heard.set)

        thread = threading.Thread(target=answer)
        thread.start()
        for _ in range(500):
            heard.clear()
            way.wake.set()
            called.release()
            await heard.wait()
        thread.join()
        way.rest()
        assert way.numbers[HEARD] > 0

    run(asyncio.wait_for(main(), 60.0))


@needs_two
@pytest.mark.parametrize("is_awake", [False, True])
def test_who_finds_the_loop_awake_does_not_wake_it(is_awake: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        loop, heard = asyncio.get_running_loop(), asyncio.Event()
        way = begin_way(loop)
        assert way is not None
        monkeypatch.setattr(way, "answer", lambda: is_awake)
        await asyncio.sleep(0.0)
        woken.clear()
        thread = threading.Timer(0.05, loop.call_soon_threadsafe, (heard.set,))
        thread.start()
        while not heard.is_set():
            await asyncio.sleep(0.1)  # it looks by itself, too
        thread.join()
        assert len(woken) == (0 if is_awake else 1)

    woken, real = [], asyncio.SelectorEventLoop._write_to_self  # type: ignore[attr-defined]
    monkeypatch.setattr(asyncio.SelectorEventLoop, "_write_to_self", lambda loop: (woken.append(1), real(loop)))
    run(asyncio.wait_for(main(), 30.0))


def test_other_loops_have_none_and_neither_have_those_of_one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    own, other = ServerLoop(), asyncio.SelectorEventLoop()
    try:
        monkeypatch.setattr(server_loop, "why_alone", lambda: "one core")
        assert begin_way(own) is begin_way(other) is own.right_of_way is None
        monkeypatch.setattr(server_loop, "why_alone", lambda: "")
        assert begin_way(other) is None
    finally:
        own.close()
        other.close()
