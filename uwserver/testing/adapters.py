"""The conformance suite for adapters: what every one must survive, and what it must leave behind (nothing)."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, get_args, get_type_hints

import msgspec

from uwserver.adapter import AdapterTable
from uwserver.ports import Event, Port, Sample
from uwserver.testing.fake_context import TICK_NS, FakeContext, sample_of
from uwserver.testing.traces import Traces, assert_no_traces

START_S = 10.0
"""Wall time to become ready."""
CANCEL_S = 1.0
"""Wall time to end once cancelled."""
SETTLE_S = 5.0
"""Wall time in which an adapter has noticed what its peer did."""
GARBAGE = (
    b"\x00" * 64,
    b"\xff" * 64,
    b"\r\n\r\n",
    bytes(range(256)),
    b"\x00\xff\xff\xff" + b"x" * 100,
    b"{" * 5000 + b"\n",
)
_TICKS_TO_SLOW_PEER = 30_000
_TICKS_ONCE_SLOW = 2000
_RECEIVE_BUFFER = 4096


class Peer(Protocol):
    """The other side of an adapter, as the suite needs it. It reads nothing of itself."""

    async def send(self, data: bytes) -> None:
        """Send raw bytes; may raise OSError when the adapter has closed."""

    async def close(self) -> None:
        """End the connection; never raises OSError."""


Connect = Callable[[FakeContext], Awaitable[Peer]]
"""Connects a peer to the running adapter of a context (``context.stats.address`` tells where)."""


@dataclass
class AdapterKit:
    """What is checked.

    Attributes:
        adapter_class, config: as the server would make it; the config takes a free port and loopback.
        connect: makes a peer.
        greeting: bytes with which a peer asks for samples, b"" when they come unasked.
        make_context: ports and services to serve.
    """

    adapter_class: type[Any]
    config: AdapterTable
    connect: Connect
    greeting: bytes = b""
    make_context: Callable[[], FakeContext] = field(default=FakeContext)

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
        peer = await asyncio.wait_for(self.kit.connect(self.context), SETTLE_S)
        self.peers.append(peer)
        return peer

    async def subscriber(self) -> Peer:
        """A peer that has asked for samples."""
        peer = await self.connect()
        await _send(peer, self.kit.greeting)
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

    async def close(self) -> None:
        """Close at once."""
        self.writer.transport.abort()
        with contextlib.suppress(OSError):
            await self.writer.wait_closed()


async def check_adapter(
    adapter_class: type[Any],
    config: AdapterTable,
    *,
    connect: Connect,
    greeting: bytes = b"",
    make_context: Callable[[], FakeContext] = FakeContext,
) -> list[str]:
    """Run every check of `CHECKS` and return their names.

    Args:
        adapter_class, config: as the server would make it; the config must take a free port on loopback.
        connect: makes a peer of the running adapter, for instance `TcpPeer.connect`.
        greeting: bytes with which a peer asks for samples; b"" when they come unasked.
        make_context: ports and services to serve, default those of `FakeContext`.

    Raises:
        AssertionError: the text names the check, what is wrong, and what the contract says.
    """
    kit = AdapterKit(adapter_class, config, connect, greeting, make_context)
    for name, check in CHECKS.items():
        before = Traces.now()
        try:
            await check(kit)
        except AssertionError as error:
            raise AssertionError(f'adapter "{kit.kind}", {name}: {error}') from error
        await assert_no_traces(before, f'adapter "{kit.kind}", {name}')
    return list(CHECKS)


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
            await _cancelled(task)
        finally:
            for peer in started.peers:
                await peer.close()


async def _cancelled(task: asyncio.Task[None]) -> None:
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


async def _send(peer: Peer, data: bytes) -> None:
    with contextlib.suppress(OSError):  # the adapter may hang up on a peer that misbehaves
        await asyncio.wait_for(peer.send(data), SETTLE_S)


# -- the checks ---------------------------------------------------------------------------------------------------------------------


async def check_configuration(kit: AdapterKit) -> None:
    """The config is typed, tagged, and survives a scenario file."""
    config_type = kit.adapter_class.Config
    assert issubclass(config_type, AdapterTable), "Config must derive from uwserver.adapter.AdapterTable"
    assert isinstance(kit.config, config_type), (
        f"the config is a {type(kit.config).__name__}, Config is {config_type.__name__}"
    )
    info = config_type.__struct_config__
    assert info.tag_field == "kind", 'Config needs the tag field "kind": derive from AdapterTable and give tag="..."'
    assert info.tag, 'Config needs tag="...": the kind in the scenario file'
    again = msgspec.convert(msgspec.to_builtins(kit.config), config_type)
    assert again == kit.config, f"the config does not survive a scenario file: {kit.config} became {again}"


async def check_starts_and_reports(kit: AdapterKit) -> None:
    """Ready means that a peer can connect, and the stats say so."""
    async with running(kit) as adapter:
        stats = adapter.context.stats
        assert stats.state == "running", f'stats.state is "{stats.state}" after ready was set, it must be "running"'
        assert stats.address, "stats.address is empty after ready was set: say where a peer finds the adapter"
        assert len(adapter.context.subscribers) == 1, "attach to the context exactly once, before ready is set"
        await adapter.subscriber()
    assert stats.state == "stopped", f'stats.state is "{stats.state}" after run() ended, it must be "stopped"'
    assert not adapter.context.subscribers, "the subscriber is still attached after run() ended"


async def check_cancelled_with_peers(kit: AdapterKit) -> None:
    """Peers that stay connected do not hold it up."""
    async with running(kit) as adapter:
        for _ in range(3):
            await adapter.subscriber()
        adapter.context.emit()


async def check_cancelled_at_once(kit: AdapterKit) -> None:
    """Cancelled before it could start."""
    context = kit.make_context()
    task: asyncio.Task[None] = asyncio.get_running_loop().create_task(
        kit.adapter_class(kit.config, context).run(asyncio.Event())
    )
    await asyncio.sleep(0)
    await _cancelled(task)
    assert not context.subscribers, "the subscriber is still attached after run() was cancelled during its start"


async def check_flickering_peer(kit: AdapterKit) -> None:
    """A peer that connects and goes at once, many times."""
    async with running(kit) as adapter:
        for _ in range(20):
            await (await adapter.connect()).close()
        await until(lambda: adapter.context.stats.peers == 0, "stats.peers does not return to 0 after all peers left")


async def check_garbage(kit: AdapterKit) -> None:
    """Bytes that are no message end neither the adapter nor the next peer's chances."""
    async with running(kit) as adapter:
        for junk in GARBAGE:
            peer = await adapter.connect()
            await _send(peer, junk)
            adapter.context.emit()
            await peer.close()
            adapter.assert_alive(f"the garbage {junk[:20]!r}")
        await until(lambda: adapter.context.stats.peers == 0, "stats.peers does not return to 0 after garbage")
        await adapter.connect()


async def check_half_message(kit: AdapterKit) -> None:
    """A peer that dies within a message."""
    async with running(kit) as adapter:
        for cut in range(1, max(2, len(kit.greeting)), 7):
            peer = await adapter.connect()
            await _send(peer, kit.greeting[:cut] or b"x")
            await peer.close()
        await until(lambda: adapter.context.stats.peers == 0, "stats.peers does not return to 0 after half messages")


async def check_slow_reader(kit: AdapterKit) -> None:
    """A peer that asks for samples and reads none costs others nothing: `put_samples` returns, another peer connects, the end is in time."""
    async with running(kit) as adapter:
        await adapter.subscriber()
        noticed = 0
        for count in range(_TICKS_TO_SLOW_PEER):
            adapter.context.emit()
            if count % 100 == 0:
                await asyncio.sleep(0)
            # The kernel's buffers hold some megabytes; once the adapter itself had to act, a little more is enough.
            noticed += adapter.context.stats.dropped > 0 or adapter.context.stats.peers == 0
            if noticed > _TICKS_ONCE_SLOW:
                break
        adapter.assert_alive("a peer that does not read")
        await adapter.connect()


async def check_strange_samples(kit: AdapterKit) -> None:
    """Invalid samples, values that are not finite, and ports it has never heard of."""
    async with running(kit) as adapter:
        context = adapter.context
        await adapter.subscriber()
        sensors = [port for port in context.ports.values() if port.direction == "sensor"]
        context.put([sample_of(port, valid=False) for port in sensors])
        for bad in (float("nan"), float("inf"), -0.0, 1e308):
            context.put([_filled(port, bad) for port in sensors])
        context.put([Sample("nobody/knows", 0, 0, 0, True, (1.0,))])
        context.put([])
        await asyncio.sleep(0.05)


def _filled(port: Port, number: float) -> Sample:
    values = tuple((number,) * field.size if field.shape else number for field in port.fields)
    return Sample(port.path, 1, TICK_NS, TICK_NS, True, values)


async def check_events(kit: AdapterKit) -> None:
    """Every event there is, and ports that go and come back."""
    async with running(kit) as adapter:
        context = adapter.context
        await adapter.subscriber()
        everything = list(context.ports.values())
        for name in get_args(get_type_hints(Event)["event"]):
            context.say(Event(name, context.tick, context.tick * TICK_NS, f"the suite says {name}"))
        context.set_ports(everything[:1])
        context.emit()
        context.set_ports(())
        context.emit()
        context.set_ports(everything)
        context.emit()
        await asyncio.sleep(0.05)


async def check_restarts(kit: AdapterKit) -> None:
    """Again and again on the same config, with a peer that outlives it."""
    for _ in range(3):
        async with running(kit) as adapter:
            await adapter.subscriber()


CHECKS: Mapping[str, Callable[[AdapterKit], Awaitable[None]]] = {
    check.__name__: check
    for check in (
        check_configuration,
        check_starts_and_reports,
        check_cancelled_with_peers,
        check_cancelled_at_once,
        check_flickering_peer,
        check_garbage,
        check_half_message,
        check_slow_reader,
        check_strange_samples,
        check_events,
        check_restarts,
    )
}
"""The suite, by name; each can be run on its own with an `AdapterKit`."""
