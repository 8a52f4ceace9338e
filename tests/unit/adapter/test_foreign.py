"""Peers that speak HTTP or TLS are known by their first bytes, however these are cut, and nothing of ours is taken for them."""

from __future__ import annotations

import asyncio
import ssl

import pytest
from browser_rig import SENT

from uwserver.adapter import AdapterStats, Connection, FirstBytes, Lines, Peers, Refusals, http_answer
from uwserver.adapter.foreign import HEAD_LIMIT, TLS_ALERT
from uwserver.testing import Loopback


def client_hello() -> bytes:
    """Of the TLS library of this Python."""
    outgoing = ssl.MemoryBIO()
    hidden = ssl.create_default_context().wrap_bio(ssl.MemoryBIO(), outgoing, server_hostname="localhost")
    with pytest.raises(ssl.SSLWantReadError):
        hidden.do_handshake()
    return outgoing.read()


HTTP = [sent.bytes_of("127.0.0.1:7600", "http://evil.example", b'{"id":1}\n') for sent in SENT] + [
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    b"BREW pot://coffee HTTP/1.0\r\n\r\n",
    b"!#$%&'*+-.^_`|~ * HTTP/1.1\r\n",
    b"get / HTTP/1.1\r\n",
    b"GET  HTTP/1.1\r\n",
    b"CONNECT evil.example:80 HTTP/1.1\r\n",
    b"GET /" + b"x" * HEAD_LIMIT,
]
OURS = [
    b'{"jsonrpc":"2.0","id":1,"method":"ping"}\n',
    b"[1]\n",
    b"\n\n",
    b"\x00\x00\x00\x05\x80",
    b"\xfd\x09\x00\x00",
    b"\xfe\x09\x00\x00",
    b"DESIRED_THRUST=40 DESIRED_RUDDER=-5\n",
    b"GET NAV_DEPTH\n",
    b"GET NAV_DEPTH HTTQ",
    b"SUBSCRIBE NAV_* 5\n",
    b"#7 GET NAV_DEPTH\n",
    b"LIST\n",
    b"CALL world/pause {}\n",
    b"ELKS CAN'T DANCE 2/8/10",
    b" GET / HTTP/1.1\r\n",
    b"\x16\x03\x09\x00\x05\x01",
    b"\x16\x03\x01\x00\x05\x02",
    b"\x16\x00\x00\x00",
    b"x" * (HEAD_LIMIT + 1),
]


def speech_of(data: bytes, size: int) -> FirstBytes:
    first = FirstBytes()
    for at in range(0, len(data), size):
        if first.speech == "unknown":
            first.receive(data[at : at + size])
    return first


@pytest.mark.parametrize("size", [1, 3, 100_000])
def test_http_tls_and_ours(size: int):
    for data in HTTP:
        assert speech_of(data, size).speech == "http", data[:60]
    hello = client_hello()
    assert speech_of(hello, size).speech == "tls"
    for data in OURS:
        first = speech_of(data, size)
        assert first.speech == "own", data[:60]
        assert data.startswith(bytes(first.held)), "nothing is lost"


@pytest.mark.parametrize(
    "begun", [b"", b"G", b"GET", b"GET ", b"GET /", b"GET / HTT", b"\x16", b"\x16\x03\x01\x02\x00"]
)
def test_what_could_still_be_either_waits(begun: bytes):
    first = FirstBytes()
    first.receive(begun)
    assert first.speech == "unknown"
    assert bytes(first.held) == begun


def test_answers_are_whole_and_of_no_origin():
    answer = http_answer("400 Bad Request", "né\n", "Allow: GET\r\n")
    head, _, body = answer.partition(b"\r\n\r\n")
    assert body == "né\n".encode()
    assert b"Content-Length: 4\r\n" in head
    assert b"Access-Control" not in head
    assert http_answer("404 Not Found", "abc", body=False).endswith(b"Content-Length: 3\r\n"
        b"X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n")  # fmt: skip


class Obeys(Connection):
    """Keeps each line that it would obey."""

    def __init__(self, peers: Peers) -> None:
        super().__init__(peers)
        self.lines = Lines(1 << 20)
        self.obeyed: list[bytes] = []

    def receive(self, data: bytes) -> None:
        self.lines.receive(data)

    def step(self) -> bool:
        line = self.lines.next_line()
        if line is not None:
            self.obeyed.append(line)
        return line is not None


@pytest.mark.parametrize("size", [1, 100_000])
def test_a_connection_obeys_nothing_of_them_and_tells_once(size: int, caplog: pytest.LogCaptureFixture):
    async def scene() -> None:
        stats = AdapterStats()
        peers = Peers(1000, Refusals("mine", stats, lambda: 0.0), stats)
        for data in HTTP:
            connection = Obeys(peers)
            wire = Loopback(connection)
            for at in range(0, len(data), size):
                wire.feed(data[at : at + size])
            wire.feed(b'{"id":2}\n' * 3)
            assert connection.obeyed == []
            assert wire.take().startswith(b"HTTP/1.1 400 Bad Request\r\n")
            assert wire.eof_written
        connection = Obeys(peers)
        wire = Loopback(connection)
        wire.feed(client_hello() + b"line\n")
        assert (wire.take(), connection.obeyed) == (TLS_ALERT, [])
        connection = Obeys(peers)
        Loopback(connection).feed(b"GET DEPTH\nLIST\n")
        assert connection.obeyed == [b"GET DEPTH", b"LIST"]
        assert stats.details["refused"] == {"http": len(HTTP), "tls": 1}
        for peer in peers:
            peer.abort()
        await asyncio.sleep(0)

    asyncio.run(scene())
    assert caplog.text.count("refused (http)") == caplog.text.count("refused (tls)") == 1
