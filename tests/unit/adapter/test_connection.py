"""A connection of the kit: turns, floods, half-open peers, last texts, and the registry of all peers."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from uwserver.adapter import AdapterStats, Connection, Conversation, Lines, Peers, Refusals, connection, peers
from uwserver.testing import FakeContext, Loopback


class Echo(Connection):
    """Gives back each line; "boom" is a fault of ours, "later" is owed until `pay`."""

    def __init__(self, peers: Peers) -> None:
        super().__init__(peers)
        self.lines = Lines(100)
        self.life: list[str] = []
        self.owes = 0
        self.quiet = 0.0

    def opened(self) -> None:
        self.life.append("opened")

    def receive(self, data: bytes) -> None:
        self.lines.receive(data)

    def step(self) -> bool:
        line = self.lines.next_line()
        if line == b"boom":
            raise RuntimeError("our own fault")
        if line == b"later":
            self.owes += 1
        elif line == b"bye":
            self.farewell(b"good bye\n")
        elif line is not None:
            self.write(line + b"\n")
        return line is not None

    @property
    def has_pending_output(self) -> bool:
        return self.owes > 0

    def quiet_until(self) -> float:
        quiet, self.quiet = self.quiet, 0.0
        return quiet

    def half_closed(self) -> None:
        self.life.append("half closed")

    def stop(self) -> None:
        self.life.append("stop")

    def closed(self) -> None:
        self.life.append("closed")


class Room:
    def __init__(self, most: int = 2) -> None:
        self.stats = AdapterStats()
        self.peers = Peers(most, Refusals("mine", self.stats, lambda: 0.0), self.stats)

    def enter(self) -> tuple[Echo, Loopback]:
        echo = Echo(self.peers)
        return echo, Loopback(echo)


def within_loop(scene: Callable[[Room], Coroutine[Any, Any, None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(scene(Room()), 120)

    asyncio.run(bounded())


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "LINGER_S", 0.02)
    monkeypatch.setattr(peers, "CLOSING_S", 0.02)


async def until(condition: Callable[[], object]) -> None:
    while not condition():
        await asyncio.sleep(0.001)


def test_lines_come_back():
    async def scene(room: Room) -> None:
        echo, wire = room.enter()
        wire.feed(b"one\ntw")
        wire.feed(b"o\n")
        assert wire.take() == b"one\ntwo\n"
        assert room.stats.peers == 1
        wire.die()
        await until(lambda: not len(room.peers))
        assert echo.life == ["opened", "closed"]
        assert room.stats.peers == 0
        echo.write(b"nobody")
        assert wire.take() == b""

    within_loop(scene)


def test_a_peer_that_is_gone_before_it_is_served_is_never_opened():
    """The socket of a connection that was reset after it was accepted has no address of a peer any more."""

    async def scene(room: Room) -> None:
        echo = Echo(room.peers)
        gone = Loopback(echo, peer=None)
        assert gone.is_lost
        await until(lambda: not len(room.peers))
        assert echo.life == ["closed"]

    within_loop(scene)


def test_a_last_text_for_a_peer_that_has_reset_the_connection(monkeypatch: pytest.MonkeyPatch):
    def refuse(_: Loopback) -> None:
        raise OSError(errno.ENOTCONN, "Transport endpoint is not connected")

    monkeypatch.setattr(Loopback, "write_eof", refuse)

    async def scene(room: Room) -> None:
        echo, wire = room.enter()
        wire.feed(b"bye\n")
        assert wire.is_lost
        await until(lambda: not len(room.peers))
        assert echo.life == ["opened", "stop", "closed"]

    within_loop(scene)


def test_much_at_once_is_worked_off_in_turns(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(connection, "TURN_S", -1.0)

    async def scene(room: Room) -> None:
        _, busy = room.enter()
        _, other = room.enter()
        busy.feed(b"line\n" * 50)
        assert busy.take() == b"line\n"
        assert not busy.is_reading()
        other.feed(b"me too\n")
        assert other.take() == b"me too\n", "another peer has its turn between"
        assert not busy.is_reading(), "it rests"
        await until(busy.is_reading)
        assert busy.take() == b"line\n" * 49

    within_loop(scene)


def test_a_peer_that_floods_is_not_read_for_a_while():
    async def scene(room: Room) -> None:
        echo, wire = room.enter()
        echo.quiet = asyncio.get_running_loop().time() + 0.02
        wire.feed(b"one\n")
        wire.feed(b"two\n")
        assert wire.take() == b"one\n"
        assert not wire.is_reading()
        await until(lambda: wire.written)
        assert wire.take() == b"two\n"

    within_loop(scene)


def test_who_only_listens_on_stays_until_it_is_owed_nothing():
    async def scene(room: Room) -> None:
        echo, wire = room.enter()
        wire.feed(b"later\n")
        wire.feed_eof()
        assert echo.life == ["opened", "half closed"]
        assert not wire.is_closing()
        echo.owes = 0
        echo.finish_if_done()
        await until(lambda: "closed" in echo.life)
        _, done = room.enter()
        done.feed_eof()
        assert done.is_closing()

    within_loop(scene)


class OneByOne(Echo):
    """Takes no line while it owes for one."""

    def step(self) -> bool:
        return not self.owes and super().step()


def test_what_waits_for_something_goes_on_when_that_is_over():
    async def scene(room: Room) -> None:
        one = OneByOne(room.peers)
        wire = Loopback(one)
        wire.feed(b"later\none\n")
        wire.feed_eof()
        one.owes = 0
        one.go_on()
        one.go_on()
        assert wire.take() == b""  # not within the caller's turn
        await until(lambda: "closed" in one.life)
        assert wire.take() == b"one\n"

    within_loop(scene)


def test_a_last_text_can_be_read_though_the_peer_still_sends():
    async def scene(room: Room) -> None:
        echo, wire = room.enter()
        wire.feed(b"bye\nignored\n")
        wire.feed(b"ignored, too\n")
        assert wire.take() == b"good bye\n"
        assert wire.eof_written
        assert echo.life == ["opened", "stop"]
        await until(lambda: "closed" in echo.life)
        echo.farewell(b"twice")
        echo.close()

    within_loop(scene)


def test_one_too_many_is_told_and_one_that_only_listens_makes_way():
    async def scene(room: Room) -> None:
        first, wire = room.enter()
        room.enter()
        third, refused = room.enter()
        assert refused.take() == b"2 clients are connected: close some, or raise max_clients of the adapter\n"
        assert "opened" not in third.life
        await until(lambda: "closed" in third.life)
        wire.feed(b"later\n")
        wire.feed_eof()
        fourth, _ = room.enter()
        assert "opened" in fourth.life
        await until(lambda: "closed" in first.life)
        assert len(room.peers) == 2

    within_loop(scene)


def test_a_fault_of_ours_ends_the_connection_and_is_logged(caplog: pytest.LogCaptureFixture):
    async def scene(room: Room) -> None:
        echo, wire = room.enter()
        _, other = room.enter()
        wire.feed(b"boom\n")
        await until(lambda: "closed" in echo.life)
        other.feed(b"still here\n")
        assert other.take() == b"still here\n"

    within_loop(scene)
    assert "our own fault" in caplog.text


@pytest.mark.parametrize("reads", [True, False])
def test_the_end_waits_for_peers_but_not_for_those_who_do_not_read(reads: bool):
    async def scene(room: Room) -> None:
        echo, wire = room.enter()
        if not reads:
            wire.stall()
        echo.write(b"x" * 100)
        await room.peers.close()
        assert echo.life == ["opened", "stop", "closed"]
        assert len(room.peers) == 0
        await room.peers.close()

    within_loop(scene)


def test_what_is_too_much_for_the_socket_comes_in_the_same_order():
    async def scene() -> None:
        loop = asyncio.get_running_loop()
        room = Room()
        server = await loop.create_server(lambda: Echo(room.peers), "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname(), limit=1 << 26)
        writer.write(b"one\ntwo\n")
        assert await reader.readline() + await reader.readline() == b"one\ntwo\n"
        (echo,) = room.peers
        pieces = [bytes([k]) * (1 << 24) for k in range(3)]
        for piece in pieces:
            echo.write(piece)
        assert await reader.readexactly(3 << 24) == b"".join(pieces)
        echo.write(b"")
        echo.write(b"end")
        assert await reader.readexactly(3) == b"end"
        writer.close()
        server.close()
        await until(lambda: not len(room.peers))

    asyncio.run(asyncio.wait_for(scene(), 60.0))


class Asker(Connection):
    """Calls the service in each line, counts its requests, and answers."""

    def __init__(self, room: Room, context: FakeContext) -> None:
        self.conversation = Conversation(context, "peer")
        super().__init__(
            room.peers, stats=room.stats, requests_per_s=2, queue_bytes=100_000, conversation=self.conversation
        )
        self.lines = Lines(100)

    def receive(self, data: bytes) -> None:
        self.lines.receive(data)

    def step(self) -> bool:
        line = self.lines.next_line()
        if line is not None and self._rate.take(self.loop.time()):
            self.conversation.call(line.decode(), {"t_s": 5.0} if b"until" in line else {}, self.answer)
        return line is not None

    def answer(self, reply: object) -> None:
        self.send_answer(b"done\n", "the peer")
        self.finish_if_done()


def test_a_peer_that_sends_too_many_requests_is_not_read_until_the_second_is_over(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(peers, "WINDOW_S", 0.02)

    async def scene(room: Room) -> None:
        asker = Asker(room, FakeContext())
        wire = Loopback(asker)
        wire.feed(b"world/pause\n" * 3)
        assert not wire.is_reading()
        await until(wire.is_reading)
        assert wire.take() == b"done\n" * 2

    within_loop(scene)


def test_a_conversation_ends_with_its_connection():
    async def scene(room: Room) -> None:
        asker = Asker(room, FakeContext(held={"world/run_until", "world/pause"}))
        wire, context = Loopback(asker), asker.conversation._context
        wire.feed(b"world/run_until\nworld/pause\n")
        wire.feed_eof()
        assert wire.take() == b"done\n", "on TCP it looks like a peer that has gone, so what takes long is cancelled"
        assert not wire.is_closing(), "the other answer is still to come"
        wire.die()
        await until(lambda: not len(room.peers))
        assert asker.conversation.is_closed
        assert [call.is_done for call in context.calls] == [True, False]

    within_loop(scene)


def test_a_peer_that_does_not_read_loses_samples_and_then_its_connection():
    async def scene(room: Room) -> None:
        asker = Asker(room, FakeContext())
        wire = Loopback(asker)
        asker.send_sample(b"12")
        wire.stall()
        for _ in range(4):
            asker.send_sample(b"x" * 60_000)
        assert (room.stats.samples_sent, room.stats.dropped, room.stats.bytes_sent) == (3, 2, 120_002)
        asker.send_answer(b"done", "the peer")
        assert asker.is_closing
        assert room.stats.last_error == "the peer did not read its answers and was disconnected"
        asker.send_sample(b"12")
        assert room.stats.samples_sent == 3

    within_loop(scene)
