"""UDP: the same requests and samples, one message in each datagram, for clients that have proven by a cookie that their address is their own.

Before an address has echoed its cookie, nothing is kept of it, and nothing is sent to it that is larger than its own datagram.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import secrets
from collections.abc import Callable, Hashable, Iterator
from typing import cast

import msgspec

from uwserver.adapter import AdapterStats, DatagramTurns, Peer, Peers, RateMeter, host_of
from uwserver.ports import Fault
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.messages import JSON, MSGPACK, Encoding, Malformed, Request, parse_json, parse_msgpack
from uwserver_adapters.native.outbox import Delivery
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.sockets.connection import SocketsConfig

DATAGRAM_LIMIT = 65507
"""Longest datagram, bytes: what UDP over IPv4 can carry."""
STRANGER_LIMIT = 2048
"""Longest datagram that is read from an address without a session, bytes."""
SMALL, PIECE = 1024, 64
"""A datagram counts as one request, and as another one for each `PIECE` bytes beyond the first `SMALL`. UDP has no other flow control."""
STRANGERS_PER_S = 1000
"""Most datagrams from addresses without a session that are read in a second. They count together, as their addresses may be forged."""
RECEIVE_BUFFER = 4 << 20
"""Receive buffer that the kernel is asked for, bytes; it may give less."""
COOKIE_S = 60.0
"""Wall time for which a cookie is given out, s. It is valid for as long after that."""
_NUMBER_SIZE = 24

Address = tuple[object, ...]


def parse_datagram(data: bytes) -> tuple[Encoding, Request | Malformed]:
    """Return encoding and message of a datagram. The first byte tells a msgpack map from JSON."""
    if data and (0x80 <= data[0] <= 0x8F or data[0] in (0xDE, 0xDF)):
        return MSGPACK, parse_msgpack(data)
    return JSON, parse_json(data.strip())


def numbered(encoding: Encoding, message: bytes, number: int) -> bytes:
    """Return a message of ours, which is a map with few members, with a further member ``n``."""
    if encoding is JSON:
        return message[:-1] + b',"n":%d}' % number
    return bytes((message[0] + 1,)) + message[1:] + b"\xa1n" + msgspec.msgpack.encode(number)


class DatagramCodec(Codec):
    """The codec for writing only: datagrams are read one by one, so nothing waits here."""

    def __init__(self, encoding: Encoding) -> None:
        super().__init__(encoding, bytes)  # a message in a datagram needs no frame
        self.limit = DATAGRAM_LIMIT

    def receive(self, data: bytes) -> None:
        """Store nothing."""

    def next_event(self) -> None:
        """Return None: no message is ever stored here."""


class DatagramOutbox:
    """Sends each message at once or not at all, and numbers what it sends.

    Args:
        send: sends a datagram; returns whether it went out.
        encoding: encoding of the client.
        stats: counts what is sent and dropped.
        refuse: gets a fault for the first sample that no datagram can carry.
    """

    deliveries: tuple[Delivery, ...] = ("latest", "ring")
    largest: int | None = DATAGRAM_LIMIT - _NUMBER_SIZE
    can_put_later = False

    def __init__(
        self, send: Callable[[bytes], bool], encoding: Encoding, stats: AdapterStats, refuse: Callable[[Fault], None]
    ) -> None:
        self._send = send
        self._encoding = encoding
        self._stats = stats
        self._refuse = refuse
        self._next = 0
        self._told = False

    def put_reply(self, message: bytes) -> None:
        """Send a reply. The client notices a lost one by its missing number."""
        self._put(message)

    def put_sample(self, key: Hashable, message: bytes, delivery: Delivery) -> None:
        """Send a sample, or count it as dropped."""
        if len(message) > DATAGRAM_LIMIT - _NUMBER_SIZE:
            self._stats.dropped += 1
            if not self._told:
                self._told = True
                text = f"a sample has {len(message)} bytes, a datagram holds {DATAGRAM_LIMIT}: select fields, or subscribe by TCP"
                self._refuse(Fault("too_large", text, "subscribe"))
        elif self._put(message):
            self._stats.samples_sent += 1
        else:
            self._stats.dropped += 1

    def put_later(self, key: Hashable, delivery: Delivery, hurry: Callable[[], bool]) -> Callable[[bytes | None], None]:
        """Not supported, as `can_put_later` says."""
        raise NotImplementedError

    def gather(self) -> None:
        """Do nothing: no message waits."""

    def flush(self) -> None:
        """Do nothing: no message waits."""

    def _put(self, message: bytes) -> bool:
        data = numbered(self._encoding, message, self._next)
        self._next += 1
        return self._send(data)


class DatagramClient:
    """An address that has shown its cookie, until its lease ends."""

    is_half_open = False

    def __init__(self, endpoint: DatagramEndpoint, address: Address, encoding: Encoding) -> None:
        service = endpoint.service
        self._endpoint = endpoint
        self._service = service
        self._address = address
        self._loop = asyncio.get_running_loop()
        outbox = DatagramOutbox(
            lambda data: endpoint.send(data, address), encoding, service.context.stats, self._refuse
        )
        self.session = service.session(DatagramCodec(encoding), outbox, lambda: None)
        self._rate = RateMeter(service.requests_per_s)
        self._heard = self._loop.time()
        self._timer = self._loop.call_later(endpoint.config.udp_lease_s, self._check_lease)

    def admits(self, size: int) -> bool:
        """Return whether a datagram of this size, bytes, may be read. It renews the lease in any case."""
        self._heard = self._loop.time()
        was_flooded = self._rate.is_flooded(self._heard)
        if self._rate.take(self._heard, 1 + max(0, size - SMALL) // PIECE):
            return True
        if not was_flooded:
            text = f"more than {self._rate.most} requests a second: send fewer, or raise max_requests_per_s"
            self._service.refusals.note("rate", text)
            self._refuse(Fault("overload", text))
        return False

    def take(self, event: Request | Malformed) -> None:
        """Carry out the message of a datagram."""
        if isinstance(event, Malformed):
            self._service.refusals.note(event.fault.code, event.fault.text)
            self.session.refuse(event.id, event.fault)
        else:
            fault = self._service.take(self.session, event, host_of(self._address))
            if fault is not None:
                self.close()

    def _refuse(self, fault: Fault) -> None:
        self.session.refuse(None, fault)

    def _check_lease(self) -> None:
        end = self._heard + self._endpoint.config.udp_lease_s
        if self._loop.time() < end:
            self._timer = self._loop.call_at(end, self._check_lease)
            return
        text = f'nothing came for {self._endpoint.config.udp_lease_s:g} s, so this session has ended: say "hello" with a new cookie'
        self._refuse(Fault("timeout", text, "udp_lease_s"))
        self.close()

    def close(self) -> None:
        """End the session: the address has to show a cookie again."""
        if not self.session.closed:
            self._timer.cancel()
            self.session.close()
            self._endpoint.forget(self._address)
            self._endpoint.peers.leave(self)

    abort = close


class DatagramEndpoint(asyncio.DatagramProtocol):
    """The UDP socket of the adapter.

    Attributes:
        service, config, peers: those of the adapter.
    """

    def __init__(self, service: NativeService, config: SocketsConfig, peers: Peers[Peer]) -> None:
        self.service = service
        self.config = config
        self.peers = peers
        self._transport: asyncio.DatagramTransport
        self._clients: dict[Address, DatagramClient] = {}
        self._secret = secrets.token_bytes(32)
        self._is_paused = False
        self._strangers = RateMeter(STRANGERS_PER_S)
        self._turns = DatagramTurns(peers.turns)
        self._loop = asyncio.get_running_loop()

    def connection_lost(self, error: Exception | None) -> None:
        """Carry out no more datagrams."""
        self._turns.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Note the transport."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def error_received(self, error: Exception) -> None:
        """Ignore a datagram that could not be delivered. The kernel does not say which: a client that has gone ends with its lease."""

    def pause_writing(self) -> None:
        """Drop what would be sent: the network takes nothing now."""
        self._is_paused = True

    def resume_writing(self) -> None:
        """Send again."""
        self._is_paused = False

    def send(self, data: bytes, address: Address) -> bool:
        """Send a datagram; return whether it was not dropped here."""
        if self._is_paused:
            return False
        self.service.context.stats.bytes_sent += len(data)
        self._transport.sendto(data, address)
        return True

    def forget(self, address: Address) -> None:
        """Forget the session of an address."""
        self._clients.pop(address, None)

    def datagram_received(self, data: bytes, address: Address) -> None:
        """Let a datagram wait for its sender's turn. All strangers count as one sender, as their addresses may be forged."""
        client = self._clients.get(address)
        if not self._admits(client, len(data), address):
            return
        if client is None and len(data) > STRANGER_LIMIT:
            self._challenge(JSON, len(data), address)
            return
        if not self._turns.put(client, len(data), lambda: self._take(data, address)):
            text = "more UDP datagrams wait for their turn than are kept: the newest is dropped"
            self.service.refusals.note("datagrams", text)

    def _take(self, data: bytes, address: Address) -> Iterator[None]:
        """Carry out a datagram. As a generator of one step it can wait for its turn."""
        client = self._clients.get(address)
        if len(data) <= DATAGRAM_LIMIT:
            encoding, message = parse_datagram(data)
        else:  # IPv6 carries a little more
            fault = Fault("too_large", f"a datagram holds at most {DATAGRAM_LIMIT} bytes")
            encoding, message = JSON, Malformed(fault)
        cookie, event = _without_cookie(message)
        if cookie is not None and self._is_valid(cookie, address):
            if client is not None:
                client.close()
            self._admit(encoding, event, address)
        elif client is not None:
            client.take(event)
        else:
            if isinstance(event, Malformed):
                self.service.refusals.note(event.fault.code, event.fault.text)
            elif cookie is not None:
                text = "a UDP hello came with a cookie that is old, or another address's"
                self.service.refusals.note("cookie", text)
            self._challenge(encoding, len(data), address)
        yield

    def _admits(self, client: DatagramClient | None, size: int, address: Address) -> bool:
        """Return whether a datagram is read at all."""
        if client is not None:
            return client.admits(size)
        now = self._loop.time()
        if self.service.lockout.is_out(host_of(address), now):
            return False
        if self._strangers.take(now):
            return True
        self.service.refusals.note("strangers", f"more than {STRANGERS_PER_S} UDP datagrams of strangers a second")
        return False

    def _admit(self, encoding: Encoding, hello: Request | Malformed, address: Address) -> None:
        client = DatagramClient(self, address, encoding)
        self._clients[address] = client
        self.peers.enter(client, host_of(address))
        fault = self.peers.admit(client)
        if fault is not None:
            client.session.refuse(None, fault)
            client.close()
            return
        if self.service.token is None:
            client.session.admit()
        if client.admits(0):
            client.take(hello)
        if not client.session.greeted:
            client.close()

    def _challenge(self, encoding: Encoding, size: int, address: Address) -> None:
        answer = {"cookie": self._cookie(address, self._slot())}
        data = msgspec.msgpack.encode(answer) if encoding is MSGPACK else msgspec.json.encode(answer)
        # Otherwise a forger could make a victim's address receive more than he sends.
        if len(data) <= size:
            self.send(data, address)

    def _slot(self) -> int:
        return int(self._loop.time() // COOKIE_S)

    def _cookie(self, address: Address, slot: int) -> str:
        digest = hmac.digest(self._secret, repr((slot, address)).encode(), hashlib.sha256)
        return base64.urlsafe_b64encode(digest[:12]).decode()

    def _is_valid(self, cookie: str, address: Address) -> bool:
        given, slot = cookie.encode("utf-8", "replace"), self._slot()
        return any(hmac.compare_digest(given, self._cookie(address, known).encode()) for known in (slot, slot - 1))


def _without_cookie(event: Request | Malformed) -> tuple[str | None, Request | Malformed]:
    """Return the cookie of a hello, and the request without it, as other transports have it."""
    if not isinstance(event, Request) or event.method != "hello" or not isinstance(event.params, dict):
        return None, event
    cookie = event.params.get("cookie")
    params = {key: value for key, value in event.params.items() if key != "cookie"}
    return cookie if isinstance(cookie, str) else None, Request(event.id, event.method, params)
