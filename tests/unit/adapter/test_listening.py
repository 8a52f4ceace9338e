"""Addresses: as users write them, why one cannot be had, and what an adapter says of itself while it serves."""

from __future__ import annotations

import asyncio
import errno

import pytest

from uwserver.adapter import (
    AdapterStats,
    CannotListen,
    Connection,
    Peers,
    Refusals,
    address_text,
    bound_socket,
    cannot_listen,
    is_loopback,
    serve_tcp,
    serving,
)
from uwserver.testing import FakeContext


@pytest.mark.parametrize(
    ("bind", "loopback", "text"),
    [
        ("127.0.0.1", True, "127.0.0.1:7"),
        ("127.9.9.9", True, "127.9.9.9:7"),
        ("::1", True, "[::1]:7"),
        ("localhost", True, "localhost:7"),
        ("0.0.0.0", False, "0.0.0.0:7"),
        ("robot.example", False, "robot.example:7"),
    ],
)
def test_addresses(bind, loopback, text):
    assert is_loopback(bind) == loopback
    assert address_text(bind, 7) == text


@pytest.mark.parametrize(
    ("number", "options", "phrases"),
    [
        (errno.EADDRINUSE, {}, ("TCP port 7 is in use, perhaps by another uwserver", "ss -ltnp", "(port = 0 takes")),
        (errno.EADDRINUSE, {"kind": "udp", "key": "udp_port"}, ("UDP port 7", "ss -lunp", "udp_port = 0")),
        (errno.EADDRINUSE, {"rival": "a MOOSDB"}, ("perhaps by a MOOSDB",)),
        (errno.EACCES, {}, ("take a port above 1023",)),
        (errno.EADDRNOTAVAIL, {}, ("no such address",)),
        (errno.EIO, {}, ("cannot listen at 127.0.0.1 TCP port 7",)),
    ],
)
def test_why_an_address_cannot_be_had(number, options, phrases):
    text = str(cannot_listen(OSError(number, "the system's word"), "127.0.0.1", 7, **options))
    for phrase in phrases:
        assert phrase in text


@pytest.mark.parametrize("kind", ["tcp", "udp"])
def test_bound_sockets(kind):
    with bound_socket("127.0.0.1", 0, kind) as first:
        assert not first.getblocking()
        port = first.getsockname()[1]
        with pytest.raises(CannotListen, match=f"{port} is in use, perhaps by a neighbour"):
            bound_socket("127.0.0.1", port, kind, rival="a neighbour")
    with pytest.raises(CannotListen, match="cannot listen"):
        bound_socket("no.such.host.invalid", 0, kind)


class Subscriber:
    def put_samples(self, samples: object) -> None:
        pass

    def put_event(self, event: object) -> None:
        pass


def test_an_adapter_says_that_it_serves_and_that_it_ended():
    context, ready, subscriber = FakeContext(), asyncio.Event(), Subscriber()
    with serving(context, subscriber, "here:7", ready):
        assert ready.is_set()
        assert (context.stats.state, context.stats.address) == ("running", "here:7")
        assert context.subscribers == [subscriber]
    assert context.stats.state == "stopped"
    assert context.subscribers == []


class Silent(Connection):
    def receive(self, data: bytes) -> None:
        pass

    def step(self) -> bool:
        return False


def test_a_server_ends_with_all_its_peers():
    async def scene() -> None:
        peers = Peers(5, Refusals("mine", AdapterStats(), lambda: 0.0))
        async with serve_tcp(lambda: Silent(peers), peers, "127.0.0.1", 0) as server:
            port = server.port
            with pytest.raises(CannotListen, match="is in use, perhaps by a rival"):
                async with serve_tcp(lambda: Silent(peers), peers, "127.0.0.1", port, rival="a rival"):
                    pass
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            while not len(peers):
                await asyncio.sleep(0.001)
        assert len(peers) == 0
        assert await reader.read() == b""
        writer.close()
        with pytest.raises(OSError, match=str(port)):
            await asyncio.open_connection("127.0.0.1", port)

    asyncio.run(scene())
