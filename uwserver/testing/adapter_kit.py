"""What the conformance suite needs of an adapter: how to start it, how a peer speaks to it, and the traces that it must not leave behind."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from uwserver.adapter import AdapterTable
from uwserver.testing.fake_context import FakeContext

START_S = 10.0
"""Wall time in which an adapter must become ready."""
CANCEL_S = 1.0
"""Wall time in which an adapter must end after it was cancelled."""
SETTLE_S = 5.0
"""Wall time in which an adapter must notice what its peer did."""
_RECEIVE_BUFFER = 4096


@dataclass(frozen=True)
class Traces:
    """The tasks, threads and open files of this process.

    Attributes:
        tasks: tasks of the running loop.
        threads: names and identifiers of threads.
        files: target of each file descriptor.
    """

    tasks: frozenset[asyncio.Task[Any]]
    threads: frozenset[str]
    files: Mapping[str, str]

    @classmethod
    def now(cls) -> Traces:
        """Return the present state."""
        threads = frozenset(f"{thread.name} ({thread.ident})" for thread in threading.enumerate())
        return cls(frozenset(asyncio.all_tasks()), threads, _open_files())

    def new_since(self, before: Traces) -> list[str]:
        """Return descriptions of what is there now and was not there before."""
        files = [
            f"file {number}: {target}" for number, target in self.files.items() if before.files.get(number) != target
        ]
        tasks = [f"task {task.get_name()}: {task.get_coro()}" for task in self.tasks - before.tasks]
        return [*tasks, *(f"thread {name}" for name in sorted(self.threads - before.threads)), *files]


def _open_files() -> dict[str, str]:
    folder = Path("/proc/self/fd")
    found = {}
    for entry in folder.iterdir() if folder.exists() else ():
        # The descriptor of the listing itself is closed already.
        with contextlib.suppress(OSError):
            found[entry.name] = str(entry.readlink())
    return found


async def assert_no_traces(before: Traces, after: str) -> None:
    """Fail if anything that was opened since `before` is left. `after` says what was done.

    Transports are freed in the next turns of the loop, threads end a moment after their last work, and the threads of a library close its
    sockets when a busy machine lets them. So this waits for up to 5 s, but only as long as something is left.

    Raises:
        AssertionError: tasks, threads, sockets or files are left; the text names them.
    """
    left: list[str] = []
    for _ in range(500):
        await asyncio.sleep(0.01)
        left = Traces.now().new_since(before)
        if not left:
            return
    raise AssertionError(f"{after} leaves behind: {'; '.join(left)}; close it in the finally of run()")


class Peer(Protocol):
    """A peer of an adapter, as the suite needs it. It reads nothing until it is asked to."""

    async def send(self, data: bytes) -> None:
        """Send raw bytes; may raise OSError if the adapter has closed the connection."""

    async def close(self) -> None:
        """End the connection; never raises OSError."""

    async def hear(self) -> bytes:
        """Wait for bytes of the adapter and return them; b"" if it has closed the connection."""


Connect = Callable[[FakeContext], Awaitable[Peer]]
"""Connects a peer to the running adapter of a context, at ``context.stats.address``."""


class DoesNotApply(Exception):
    """The protocol cannot express what a check needs; the text says what that is."""


@dataclass(frozen=True)
class Requests:
    """The bytes by which a peer makes requests in this protocol.

    A request that the protocol cannot express is b""; the checks that need it are reported as not applicable.

    Attributes:
        call: calls `service`; that of the world with `t_s` = 9. It is sent once by each peer.
        cancel: cancels that call.
        brief: calls the service with a time-out of at most a second.
        many: calls the service too, and can be sent again and again. If the protocol has no calls, any request that it takes often.
        misspelt: calls `world/run_untill`.
        speak: connects a peer that can send these requests, if `connect` of the suite connects one that cannot.
        service: path of the service of the context that is called.
        outlives: whether the call belongs to the vehicle and not to the peer, like an order in MAVLink, so that it goes on when the peer leaves.
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
    """An adapter that is checked.

    Attributes:
        adapter_class: the class of the adapter.
        config: its configuration, with a free port on loopback.
        connect: connects a peer.
        greeting: bytes with which a peer asks for samples; b"" if they come unasked.
        make_context: makes a context with the ports and services to serve.
        requests: how a peer calls services; None for a protocol without calls.
    """

    adapter_class: type[Any]
    config: AdapterTable
    connect: Connect
    greeting: bytes = b""
    make_context: Callable[[], FakeContext] = field(default=FakeContext)
    requests: Requests | None = None

    @property
    def kind(self) -> str:
        """Kind of the adapter in a scenario."""
        return str(self.config.__struct_config__.tag)


@dataclass
class Running:
    """A started adapter."""

    kit: AdapterKit
    context: FakeContext
    task: asyncio.Task[None]
    peers: list[Peer] = field(default_factory=list)

    async def connect(self, connect: Connect | None = None) -> Peer:
        """Connect a peer, by default that of the kit. It is closed after the adapter has ended, if the check has not closed it."""
        peer = await asyncio.wait_for((connect or self.kit.connect)(self.context), SETTLE_S)
        self.peers.append(peer)
        return peer

    async def subscriber(self) -> Peer:
        """Connect a peer that asks for samples."""
        peer = await self.connect()
        await send(peer, self.kit.greeting)
        await asyncio.sleep(0.05)
        return peer

    async def caller(self, requests: Requests) -> Peer:
        """Connect a peer that can call services. Unless it is a special one, it asks for samples first, because some protocols need that."""
        return await (self.subscriber() if requests.speak is None else self.connect(requests.speak))

    def assert_alive(self, after: str) -> None:
        """Fail if the adapter has ended."""
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
        """Connect with a small receive buffer, so that the adapter soon notices a peer that does not read."""
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
        """Send raw bytes; raises OSError if the adapter has closed the connection."""
        self.writer.write(data)
        await self.writer.drain()

    async def hear(self) -> bytes:
        """Wait for bytes and return them; b"" if the adapter has closed the connection."""
        with contextlib.suppress(OSError):
            return await self.reader.read(1 << 16)
        return b""

    async def close(self) -> None:
        """Close the connection at once."""
        self.writer.transport.abort()
        with contextlib.suppress(OSError):
            await self.writer.wait_closed()


def knock(peer: TcpPeer) -> socket.socket:
    """Begin one more connection to where a peer is connected, and wait for nothing. Closing the socket resets the connection."""
    stream = socket.socket(peer.writer.get_extra_info("socket").family)
    stream.setblocking(False)
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    stream.connect_ex(peer.writer.get_extra_info("peername"))
    return stream


@contextlib.contextmanager
def failures_of_callbacks() -> Iterator[list[str]]:
    """Within the block, collect what the running loop reports of callbacks and tasks that fail, instead of logging it."""
    loop, failures = asyncio.get_running_loop(), list[str]()
    before = loop.get_exception_handler()
    loop.set_exception_handler(lambda _, said: failures.append(f"{said['message']}: {said.get('exception')!r}"))
    try:
        yield failures
    finally:
        loop.set_exception_handler(before)


@contextlib.asynccontextmanager
async def running(kit: AdapterKit) -> AsyncIterator[Running]:
    """Run an adapter within the block, and cancel it at the end, which must take less than `CANCEL_S`."""
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
    """Cancel an adapter and wait for its end; raises AssertionError if that takes longer than `CANCEL_S`."""
    task.cancel()
    await asyncio.wait([task], timeout=CANCEL_S)
    assert task.done(), (
        f"run() has not ended {CANCEL_S:g} s after it was cancelled: do not swallow CancelledError, do not wait for peers"
    )
    # Marks an exception as retrieved; `assert_alive` has reported it.
    if not task.cancelled():
        task.exception()


async def until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition; raises AssertionError with the text `what` if it does not become true within `SETTLE_S`."""
    loop = asyncio.get_running_loop()
    end = loop.time() + SETTLE_S
    while not condition():
        assert loop.time() < end, f"{what} (waited {SETTLE_S:g} s)"
        await asyncio.sleep(0.005)


async def send(peer: Peer, data: bytes) -> None:
    """Send bytes; raises TimeoutError if the adapter takes nothing for `SETTLE_S`. The adapter may hang up on a peer that misbehaves."""
    with contextlib.suppress(OSError):
        await asyncio.wait_for(peer.send(data), SETTLE_S)
