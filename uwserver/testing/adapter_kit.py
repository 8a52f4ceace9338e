"""What the conformance suite for adapters needs of each: how it is started, and how a peer speaks to it."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from uwserver.adapter import AdapterTable
from uwserver.testing.fake_context import FakeContext

START_S = 10.0
"""Wall time to become ready."""
CANCEL_S = 1.0
"""Wall time to end once cancelled."""
SETTLE_S = 5.0
"""Wall time in which an adapter has noticed what its peer did."""
_RECEIVE_BUFFER = 4096


class Peer(Protocol):
    """The other side of an adapter, as the suite needs it. It reads nothing of itself."""

    async def send(self, data: bytes) -> None:
        """Send raw bytes; may raise OSError when the adapter has closed."""

    async def close(self) -> None:
        """End the connection; never raises OSError."""

    async def hear(self) -> bytes:
        """Wait for bytes of the adapter and return them; b"" once it has closed."""


Connect = Callable[[FakeContext], Awaitable[Peer]]
"""Connects a peer to the running adapter of a context (``context.stats.address`` tells where)."""


class DoesNotApply(Exception):
    """A check asks for what the protocol cannot say; the text tells what."""


@dataclass(frozen=True)
class Requests:
    """How a peer asks in this protocol. What it cannot say is b"": the checks that need it are reported as such.

    Attributes:
        call: calls `service`, that of the world with `t_s` = 9; once for each peer.
        cancel: cancels that call.
        brief: calls it with a time-out of a second at most.
        many: calls it, too, and can be sent again and again; where there are no calls, whatever the protocol takes most often.
        misspelt: calls `world/run_untill`.
        speak: makes a peer that can say this, where `connect` of the suite makes one that cannot.
        service: of the context, that is called.
        outlives: the call is the vehicle's rather than the peer's, as an order of MAVLink: it goes on when the peer has left.
    """

    call: bytes = b""
    cancel: bytes = b""
    brief: bytes = b""
    many: bytes = b""
    misspelt: bytes = b""
    speak: Connect | None = None
    service: str = "world/run_until"
    outlives: bool = False


@dataclass
class AdapterKit:
    """What is checked.

    Attributes:
        adapter_class, config: as the server would make it; the config takes a free port and loopback.
        connect: makes a peer.
        greeting: bytes with which a peer asks for samples, b"" when they come unasked.
        make_context: ports and services to serve.
        requests: how a peer calls services; None for a protocol that has no calls.
    """

    adapter_class: type[Any]
    config: AdapterTable
    connect: Connect
    greeting: bytes = b""
    make_context: Callable[[], FakeContext] = field(default=FakeContext)
    requests: Requests | None = None

    @property
    def kind(self) -> str:
        """As the scenario names it."""
        return str(self.config.__struct_config__.tag)


@dataclass
class Running:
    """A started adapter."""

    kit: AdapterKit
    context: FakeContext
    task: asyncio.Task[None]
    peers: list[Peer] = field(default_factory=list)

    async def connect(self) -> Peer:
        """A peer; closed after the adapter has ended, if the check has not done so."""
        return await self._made(self.kit.connect)

    async def caller(self, requests: Requests) -> Peer:
        """A peer that calls services, and has asked for samples as far as it must to be heard."""
        peer = await self._made(requests.speak or self.kit.connect)
        if requests.speak is None:
            await send(peer, self.kit.greeting)
            await asyncio.sleep(0.05)
        return peer

    async def _made(self, connect: Connect) -> Peer:
        peer = await asyncio.wait_for(connect(self.context), SETTLE_S)
        self.peers.append(peer)
        return peer

    async def subscriber(self) -> Peer:
        """A peer that has asked for samples."""
        peer = await self.connect()
        await send(peer, self.kit.greeting)
        await asyncio.sleep(0.05)
        return peer

    def assert_alive(self, after: str) -> None:
        """It still runs."""
        if self.task.done():
            error = None if self.task.cancelled() else self.task.exception()
            raise AssertionError(
                f"the adapter ended after {after}: {error!r}; run() serves until it is cancelled"
            ) from error


class TcpPeer:
    """A peer of an adapter that listens on TCP at ``host:port`` of its `stats.address`."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    @classmethod
    async def connect(cls, context: FakeContext) -> TcpPeer:
        """Connect; the peer takes in little that nobody reads, so that a slow reader is seen soon."""
        host, _, port = context.stats.address.rpartition(":")
        host = host.strip("[]")
        stream = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
        stream.setblocking(False)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        try:
            await asyncio.get_running_loop().sock_connect(stream, (host, int(port)))
        except BaseException:
            stream.close()
            raise
        return cls(*await asyncio.open_connection(sock=stream, limit=_RECEIVE_BUFFER))

    async def send(self, data: bytes) -> None:
        """Send raw bytes."""
        self.writer.write(data)
        await self.writer.drain()

    async def hear(self) -> bytes:
        """Wait for bytes and return them; b"" once the adapter has closed."""
        with contextlib.suppress(OSError):
            return await self.reader.read(1 << 16)
        return b""

    async def close(self) -> None:
        """Close at once."""
        self.writer.transport.abort()
        with contextlib.suppress(OSError):
            await self.writer.wait_closed()


@contextlib.asynccontextmanager
async def running(kit: AdapterKit) -> AsyncIterator[Running]:
    """A started adapter; cancelled at the end, which must take less than a second."""
    context = kit.make_context()
    ready = asyncio.Event()
    task: asyncio.Task[None] = asyncio.get_running_loop().create_task(kit.adapter_class(kit.config, context).run(ready))
    started = Running(kit, context, task)
    try:
        waiting = asyncio.ensure_future(ready.wait())
        await asyncio.wait([task, waiting], timeout=START_S, return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        started.assert_alive("its start")
        assert ready.is_set(), f"ready was not set within {START_S:g} s: set it once peers can connect"
        yield started
        started.assert_alive("the check")
    finally:
        try:
            await cancelled(task)
        finally:
            for peer in started.peers:
                await peer.close()


async def cancelled(task: asyncio.Task[None]) -> None:
    """Cancel an adapter and wait for its end; raises AssertionError when it takes longer than `CANCEL_S`."""
    task.cancel()
    await asyncio.wait([task], timeout=CANCEL_S)
    assert task.done(), (
        f"run() has not ended {CANCEL_S:g} s after it was cancelled: do not swallow CancelledError, do not wait for peers"
    )
    if not task.cancelled():
        task.exception()  # marks it as seen; `assert_alive` has told of it


async def until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition; raises AssertionError with `what` when it does not come true in `SETTLE_S`."""
    loop = asyncio.get_running_loop()
    end = loop.time() + SETTLE_S
    while not condition():
        assert loop.time() < end, f"{what} (waited {SETTLE_S:g} s)"
        await asyncio.sleep(0.005)


async def send(peer: Peer, data: bytes) -> None:
    """Send, unless the adapter has closed; raises TimeoutError when it takes nothing for `SETTLE_S`."""
    with contextlib.suppress(OSError):  # the adapter may hang up on a peer that misbehaves
        await asyncio.wait_for(peer.send(data), SETTLE_S)
