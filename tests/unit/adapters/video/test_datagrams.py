"""Pictures by UDP: on which thread, in which order, and what waits when the system takes no more."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Coroutine
from typing import Any

from uwserver_adapters.video import datagrams
from uwserver_adapters.video.datagrams import WAITING, Route, Sender

from uwserver.adapter import AdapterStats

PATIENCE_S = 120.0
THERE = ("127.0.0.1", 9)


def bounded(work: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(work, PATIENCE_S))


async def until(said: Any) -> None:
    while not said():
        await asyncio.sleep(0.005)


class Slow:
    """A socket that sends when the test lets it, and says on which thread."""

    def __init__(self) -> None:
        self.go_on, self.entered = threading.Event(), threading.Event()
        self.sent: list[tuple[bytes, Any]] = []
        self.threads: set[int] = set()

    def fileno(self) -> int:
        return -1

    def sendto(self, data: bytes, address: Any, /) -> int:
        self.entered.set()
        assert self.go_on.wait(PATIENCE_S)
        self.threads.add(threading.get_ident())
        self.sent.append((data, address))
        return len(data)


def test_packets_go_in_order_on_a_thread_of_their_own() -> None:
    async def whole() -> None:
        sender, out, other = Sender(AdapterStats()), Slow(), Slow()
        out.go_on.set()
        other.go_on.set()
        route = sender.route(out, THERE)
        assert route.send([b"a", b"b"], (other, ("127.0.0.1", 10), [b"report"]))
        assert route.send([b"c"])
        await until(lambda: route.done == 2)
        assert out.sent == [(b"a", THERE), (b"b", THERE), (b"c", THERE)]
        assert other.sent == [(b"report", ("127.0.0.1", 10))]
        assert threading.get_ident() not in out.threads | other.threads
        await sender.close()

    bounded(whole())


def test_pictures_are_left_out_while_those_before_are_under_way() -> None:
    async def whole() -> None:
        sender, out = Sender(AdapterStats()), Slow()
        route, ended = sender.route(out, THERE), sender.route(out, THERE)
        assert [route.send([b"%d" % k]) for k in range(4)] == [True] * WAITING + [False] * (4 - WAITING)
        assert ended.send([b"x"])  # another has room of its own
        ended.is_over = True
        out.go_on.set()
        await until(lambda: (route.done, ended.done) == (WAITING, 1))
        assert route.send([b"last"])
        await until(lambda: route.done == WAITING + 1)
        assert [data for data, _ in out.sent] == [b"0", b"1", b"last"]
        await sender.close()

    bounded(whole())


class Full:
    """A socket that the system lets send now and then."""

    def __init__(self, end: socket.socket, most: int) -> None:
        self.end, self.most, self.sent = end, most, 0

    def fileno(self) -> int:
        return self.end.fileno()

    def sendto(self, data: bytes, address: Any, /) -> int:
        self.sent += 1
        if self.sent % self.most == 0:
            raise BlockingIOError
        return self.end.sendto(data, address)


def test_a_system_that_is_busy_is_waited_for() -> None:
    async def whole() -> None:
        stats = AdapterStats()
        with socket.socket(type=socket.SOCK_DGRAM) as end, socket.socket(type=socket.SOCK_DGRAM) as receiver:
            receiver.bind(("127.0.0.1", 0))
            receiver.setblocking(False)
            sender = Sender(stats)
            route = sender.route(Full(end, 2), receiver.getsockname())
            assert route.send([b"a", b"b", b"c"])
            await until(lambda: route.done)
            assert [receiver.recv(10) for _ in range(3)] == [b"a", b"b", b"c"]
            await sender.close()
        assert stats.dropped == 0

    bounded(whole())


def test_what_the_system_does_not_take_ends_its_picture_and_is_counted(monkeypatch) -> None:
    monkeypatch.setattr(datagrams, "PATIENCE_S", 0.02)

    async def whole() -> None:
        stats = AdapterStats()
        with socket.socket(type=socket.SOCK_DGRAM) as end:
            sender = Sender(stats)
            for out in (Full(end, 1), _Unreachable(end, 1)):
                route: Route = sender.route(out, THERE)
                assert route.send([b"a", b"b"])
                await until(lambda: route.done)  # noqa: B023
            await sender.close()
        assert (stats.dropped, stats.errors) == (2, 0)

    bounded(whole())


class _Unreachable(Full):
    def sendto(self, data: bytes, address: Any, /) -> int:
        raise OSError(101, "no way there")


def test_sockets_are_closed_at_the_end_and_nothing_more_is_sent() -> None:
    async def whole() -> None:
        sender, out = Sender(AdapterStats()), Slow()
        own = sender.own(socket.socket(type=socket.SOCK_DGRAM))
        route = sender.route(out, THERE)
        route.send([b"a", b"b"])
        route.send([b"c"])
        await until(out.entered.is_set)
        closing = asyncio.ensure_future(sender.close())
        await asyncio.sleep(0)
        out.go_on.set()
        await closing
        assert [data for data, _ in out.sent] == [b"a"]
        assert own.fileno() == -1

    bounded(whole())
