"""The conformance suite for adapters: what every adapter must survive. It must leave nothing behind."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, get_args, get_type_hints

import msgspec

from uwserver.adapter import AdapterTable
from uwserver.ports import Event, Port, Sample
from uwserver.testing.adapter_kit import (
    AdapterKit,
    Connect,
    DoesNotApply,
    Requests,
    TcpPeer,
    Traces,
    assert_no_traces,
    cancelled,
    failures_of_callbacks,
    knock,
    running,
    send,
    until,
)
from uwserver.testing.call_checks import (
    check_cancel,
    check_did_you_mean,
    check_flood,
    check_leaves_in_the_middle_of_a_call,
    check_time_out,
)
from uwserver.testing.fake_context import TICK_NS, FakeContext, sample_of

GARBAGE = (
    b"\x00" * 64,
    b"\xff" * 64,
    b"\r\n\r\n",
    bytes(range(256)),
    b"\x00\xff\xff\xff" + b"x" * 100,
    b"{" * 5000 + b"\n",
)
PASSED = "passed"
_TICKS_TO_SLOW_PEER = 30_000
_TICKS_ONCE_SLOW = 2000
_STORMS, _AT_ONCE, _TURNS_OF_A_STORM = 5, 12, 20


async def check_adapter(
    adapter_class: type[Any],
    config: AdapterTable,
    *,
    connect: Connect,
    greeting: bytes = b"",
    make_context: Callable[[], FakeContext] = FakeContext,
    requests: Requests | None = None,
) -> dict[str, str]:
    """Run every check of `CHECKS`.

    Args:
        adapter_class: the class of the adapter.
        config: its configuration, which must take a free port on loopback.
        connect: connects a peer to the running adapter, for example `TcpPeer.connect`.
        greeting: bytes with which a peer asks for samples; b"" if they come unasked.
        make_context: makes a context with the ports and services to serve; default those of `FakeContext`.
        requests: how a peer calls services; None for a protocol without calls.

    Returns:
        The outcome of each check by its name: `PASSED`, or "does not apply: " and what the protocol cannot express.

    Raises:
        AssertionError: the text names the check, what is wrong, and what the contract says.
    """
    kit = AdapterKit(adapter_class, config, connect, greeting, make_context, requests)
    outcomes = {}
    for name, check in CHECKS.items():
        outcomes[name] = PASSED
        before = Traces.now()
        try:
            await check(kit)
        except DoesNotApply as reason:
            outcomes[name] = f"does not apply: {reason}"
        except AssertionError as error:
            raise AssertionError(f'adapter "{kit.kind}", {name}: {error}') from error
        await assert_no_traces(before, f'adapter "{kit.kind}", {name}')
    return outcomes


# -- the checks ---------------------------------------------------------------------------------------------------------------------


async def check_configuration(kit: AdapterKit) -> None:
    """Check that the configuration is typed and tagged, and survives a scenario file."""
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
    """Check that a peer can connect once the adapter is ready, and that the stats say so."""
    async with running(kit) as adapter:
        stats = adapter.context.stats
        assert stats.state == "running", f'stats.state is "{stats.state}" after ready was set, it must be "running"'
        assert stats.address, "stats.address is empty after ready was set: say where a peer finds the adapter"
        assert len(adapter.context.subscribers) == 1, "attach to the context exactly once, before ready is set"
        await adapter.subscriber()
    assert stats.state == "stopped", f'stats.state is "{stats.state}" after run() ended, it must be "stopped"'
    assert not adapter.context.subscribers, "the subscriber is still attached after run() ended"


async def check_cancelled_with_peers(kit: AdapterKit) -> None:
    """Check that peers that stay connected do not delay the end."""
    async with running(kit) as adapter:
        for _ in range(3):
            await adapter.subscriber()
        adapter.context.emit()


async def check_cancelled_at_once(kit: AdapterKit) -> None:
    """Check that an adapter can be cancelled before it has started."""
    context = kit.make_context()
    task: asyncio.Task[None] = asyncio.get_running_loop().create_task(
        kit.adapter_class(kit.config, context).run(asyncio.Event())
    )
    await asyncio.sleep(0)
    await cancelled(task)
    assert not context.subscribers, "the subscriber is still attached after run() was cancelled during its start"


async def check_flickering_peer(kit: AdapterKit) -> None:
    """Check that peers can connect and leave at once, many times."""
    async with running(kit) as adapter:
        for _ in range(20):
            await (await adapter.connect()).close()
        await until(lambda: adapter.context.stats.peers == 0, "stats.peers does not return to 0 after all peers left")


async def check_connection_storm(kit: AdapterKit) -> None:
    """Check that connections that come and go while samples are delivered cost nobody a sample: also those that are reset at once, as by a scanner or
    a process that is killed."""
    async with running(kit) as adapter:
        peer = await adapter.subscriber()
        if not isinstance(peer, TcpPeer):
            raise DoesNotApply("the protocol has no connections of TCP")
        with failures_of_callbacks() as failures:
            for _ in range(_STORMS):
                storm = [knock(peer) for _ in range(_AT_ONCE)]
                for stream in storm[::2]:
                    stream.close()
                for _ in range(_TURNS_OF_A_STORM):
                    adapter.context.emit()
                    await asyncio.sleep(0)
                for stream in storm[1::2]:
                    stream.close()
            adapter.assert_alive("a storm of connections")
            await adapter.subscriber()
        assert not failures, f"a storm of connections makes callbacks of the loop fail: {failures[0]}"


async def check_garbage(kit: AdapterKit) -> None:
    """Check that bytes that are no message neither end the adapter nor keep the next peer out."""
    async with running(kit) as adapter:
        for junk in GARBAGE:
            peer = await adapter.connect()
            await send(peer, junk)
            adapter.context.emit()
            await peer.close()
            adapter.assert_alive(f"the garbage {junk[:20]!r}")
        await until(lambda: adapter.context.stats.peers == 0, "stats.peers does not return to 0 after garbage")
        await adapter.connect()


async def check_half_message(kit: AdapterKit) -> None:
    """Check that peers may die in the middle of a message."""
    async with running(kit) as adapter:
        for cut in range(1, max(2, len(kit.greeting)), 7):
            peer = await adapter.connect()
            await send(peer, kit.greeting[:cut] or b"x")
            await peer.close()
        await until(lambda: adapter.context.stats.peers == 0, "stats.peers does not return to 0 after half messages")


async def check_slow_reader(kit: AdapterKit) -> None:
    """Check that a peer that asks for samples and reads none costs others nothing: `put_samples` returns, another peer can connect, and the adapter
    ends in time."""
    async with running(kit) as adapter:
        await adapter.subscriber()
        noticed = 0
        for count in range(_TICKS_TO_SLOW_PEER):
            adapter.context.emit()
            if count % 100 == 0:
                await asyncio.sleep(0)
            # The buffers of the kernel hold some megabytes. Once the adapter has dropped samples or the peer, a few more ticks are enough.
            noticed += adapter.context.stats.dropped > 0 or adapter.context.stats.peers == 0
            if noticed > _TICKS_ONCE_SLOW:
                break
        adapter.assert_alive("a peer that does not read")
        await adapter.connect()


async def check_strange_samples(kit: AdapterKit) -> None:
    """Check that the adapter survives invalid samples, values that are not finite, and samples of unknown ports."""
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
    """Check that the adapter survives every kind of event, and ports that disappear and come back."""
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
    """Check that the adapter can be started again with the same configuration, with a peer that is still connected when it ends."""
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
        check_connection_storm,
        check_garbage,
        check_half_message,
        check_slow_reader,
        check_strange_samples,
        check_events,
        check_restarts,
        check_leaves_in_the_middle_of_a_call,
        check_cancel,
        check_time_out,
        check_flood,
        check_did_you_mean,
    )
}
"""The checks of the suite by name. Each can be run on its own with an `AdapterKit`."""
