"""A port goes on whatever happens: no descriptors left, strangers in crowds, names that stand for several addresses."""

from __future__ import annotations

import asyncio
import resource
import socket
import struct

import pytest

from uwserver.adapter import AdapterStats, CannotListen, Connection, Lines, Peers, Refusals, accepting, serve_tcp


class Echo(Connection):
    """Gives back each line; the first one admits it."""

    def __init__(self, peers: Peers, first_message_s: float) -> None:
        super().__init__(peers, first_message_s)
        self.lines = Lines(100)

    def receive(self, data: bytes) -> None:
        self.lines.receive(data)

    def step(self) -> bool:
        line = self.lines.next_line()
        if line is not None and self.admit():
            self.write(line + b"\n")
        return line is not None


def peers_of(stats: AdapterStats, **places: int) -> Peers:
    return Peers(100, Refusals("mine", stats, lambda: 0.0), stats, **places)


async def echo(port: int) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"line\n")
    try:
        return await reader.readline()
    finally:
        writer.close()


def test_without_descriptors_it_waits_and_goes_on(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture):
    monkeypatch.setattr(accepting, "PAUSE_S", 0.02)

    async def scene() -> None:
        stats = AdapterStats()
        peers = peers_of(stats)
        async with serve_tcp(lambda: Echo(peers, 10.0), peers, "127.0.0.1", 0) as listener:
            knocking = socket.socket()
            knocking.setblocking(False)
            before = resource.getrlimit(resource.RLIMIT_NOFILE)
            spare = socket.socket()
            resource.setrlimit(resource.RLIMIT_NOFILE, (spare.fileno(), before[1]))
            try:
                await asyncio.get_running_loop().sock_connect(knocking, ("127.0.0.1", listener.port))
                while stats.details.get("refused", {}).get("descriptors", 0) < 3:
                    await asyncio.sleep(0.001)
                assert len(peers) == 0
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, before)
                spare.close()
            reader, writer = await asyncio.open_connection(sock=knocking)
            writer.write(b"still here\n")
            assert await reader.readline() == b"still here\n"
            writer.close()

    asyncio.run(asyncio.wait_for(scene(), 120))
    assert caplog.text.count("ulimit -n") == 1
    assert len(caplog.records) == 1, "no traceback"


def test_who_says_nothing_is_ended(caplog: pytest.LogCaptureFixture):
    async def scene() -> None:
        stats = AdapterStats()
        peers = peers_of(stats)
        async with serve_tcp(lambda: Echo(peers, 0.5), peers, "127.0.0.1", 0) as listener:
            reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
            assert await reader.read() == b"nothing valid came within 0.5 s\n"
            writer.close()
            reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
            writer.write(b"line\n")
            await reader.readline()
            await asyncio.sleep(0.6)
            writer.write(b"again\n")
            assert await reader.readline() == b"again\n", "who was admitted may be silent"
            writer.close()
        assert stats.details["refused"] == {"timeout": 1}

    asyncio.run(asyncio.wait_for(scene(), 120))


def test_crowds_of_strangers_leave_room_for_others():
    async def scene() -> None:
        stats = AdapterStats()
        peers = peers_of(stats, strangers=8)
        async with serve_tcp(lambda: Echo(peers, 10.0), peers, "127.0.0.1", 0) as listener:
            crowd = [await asyncio.open_connection("127.0.0.1", listener.port) for _ in range(50)]
            assert await echo(listener.port) == b"line\n"
            while len(peers) > 8:
                await asyncio.sleep(0.001)
            for _, writer in crowd:
                writer.transport.abort()

    asyncio.run(asyncio.wait_for(scene(), 120))


def test_a_name_is_served_at_all_its_addresses():
    async def scene() -> None:
        peers = peers_of(AdapterStats())
        async with serve_tcp(lambda: Echo(peers, 10.0), peers, "localhost", 0) as listener:
            assert {stream.getsockname()[1] for stream in listener.sockets} == {listener.port}
            assert await echo(listener.port) == b"line\n"
            listener.close()
            listener.close()
        with pytest.raises(CannotListen):
            async with serve_tcp(lambda: Echo(peers, 10.0), peers, "no.such.host.invalid", 0):
                pass

    asyncio.run(asyncio.wait_for(scene(), 120))


def test_who_cut_the_line_is_written_to_no_more(caplog: pytest.LogCaptureFixture):
    """Between the fatal write and the end that the loop tells a turn later there may be many writes; the library logs each."""

    async def scene() -> None:
        peers = peers_of(AdapterStats())
        made: list[Echo] = []

        def make() -> Echo:
            made.append(Echo(peers, 10.0))
            return made[-1]

        async with serve_tcp(make, peers, "127.0.0.1", 0) as listener:
            _, writer = await asyncio.open_connection("127.0.0.1", listener.port)
            while not made or not hasattr(made[0], "transport"):
                await asyncio.sleep(0.001)
            writer.transport.get_extra_info("socket").setsockopt(
                socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
            )
            writer.transport.abort()
            await asyncio.sleep(0)
            for _ in range(50):
                made[0].write(b"x")
            while len(peers):
                await asyncio.sleep(0.001)

    asyncio.run(asyncio.wait_for(scene(), 120))
    assert caplog.records == []


def test_a_reply_does_not_wait_for_the_acknowledgement_of_the_sample_before_it():
    """Nagle's algorithm would hold it back until the peer's delayed acknowledgement."""
    delays: list[int] = []

    class Asked(Echo):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            stream = transport.get_extra_info("socket")
            delays.append(stream.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))

    async def scene() -> None:
        peers = peers_of(AdapterStats())
        async with serve_tcp(lambda: Asked(peers, 10.0), peers, "127.0.0.1", 0) as listener:
            assert await echo(listener.port) == b"line\n"

    asyncio.run(scene())
    assert len(delays) == 1
    assert delays[0] != 0


def test_who_still_arrives_is_no_peer_yet():
    """A loop over the peers, such as that which gives each a sample, never meets an object that is none."""

    async def scene() -> None:
        stats = AdapterStats()
        peers = peers_of(stats, strangers=3)
        met: set[type] = set()
        async with serve_tcp(lambda: Echo(peers, 10.0), peers, "127.0.0.1", 0) as listener:
            knocking = [socket.create_connection(("127.0.0.1", listener.port)) for _ in range(5)]
            while len(peers) < 3:
                met.update(type(peer) for peer in peers)
                assert stats.peers == len(peers)
                await asyncio.sleep(0)
            for stream in knocking:
                stream.close()
        assert met <= {Echo}
        assert not len(peers)

    asyncio.run(asyncio.wait_for(scene(), 120))
