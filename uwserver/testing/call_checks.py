"""The part of the conformance suite that calls services: peers that leave, cancel, wait too long, flood, or misspell a name."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from uwserver.ports import Fault, Reply
from uwserver.testing import adapter_kit
from uwserver.testing.adapter_kit import AdapterKit, DoesNotApply, Peer, Requests, Running, running, send, until
from uwserver.testing.fake_context import TICK_NS, HeldCall

FLOOD = 5000
"""Requests of one peer that does not wait for answers."""
_QUIET_S = 0.5
_UNSAID = {
    "call": "the protocol has no calls of services",
    "cancel": "the protocol cannot cancel a call",
    "brief": "the protocol has no time-out of a call",
    "many": "the protocol cannot ask again and again",
    "misspelt": "the protocol names no service",
}


@contextlib.asynccontextmanager
async def calling(kit: AdapterKit, *needs: str) -> AsyncIterator[tuple[Running, Requests, Peer]]:
    """Run an adapter whose calls wait for the suite; yields it, the requests of its protocol, and a peer that can send them.

    Args:
        kit: the adapter.
        needs: names of the requests that the check sends.

    Raises:
        DoesNotApply: the protocol cannot express one of them.
    """
    requests = kit.requests
    for need in needs:
        if requests is None or not getattr(requests, need):
            raise DoesNotApply(_UNSAID[need])
    assert requests is not None
    async with running(kit) as adapter:
        adapter.context.held.add(requests.service)
        yield adapter, requests, await adapter.caller(requests)


async def _called(adapter: Running, peer: Peer, request: bytes) -> HeldCall:
    """Send a call and wait until it has reached the world."""
    context = adapter.context
    before = len(context.calls)
    await send(peer, request)
    await until(lambda: len(context.calls) > before, f"the call {request[:60]!r} does not reach the world")
    return context.calls[-1]


async def check_leaves_in_the_middle_of_a_call(kit: AdapterKit) -> None:
    """Check that the long-running call of a peer that has left ends, at its time-out at the latest, unless it belongs to the vehicle.

    What the world still reports about the call must disturb nobody.
    """
    async with calling(kit, "call") as (adapter, requests, peer):
        call = await _called(adapter, peer, requests.brief or requests.call)
        await peer.close()

        def has_ended() -> bool:
            # On TCP, a peer that has left looks like one that only listens, until something is written to it.
            adapter.context.emit()
            return call.is_done

        if requests.outlives:
            await _gone(adapter)
        else:
            await until(
                has_ended, "the call of a peer that has left goes on: close its Conversation, or cancel the call"
            )
        call.progress(0.5)
        call.finish(Reply(1, TICK_NS, fault=Fault("preempted", "too late")))
        adapter.context.emit()
        adapter.assert_alive("a peer that left in the middle of a call")
        await _called(adapter, await adapter.caller(requests), requests.brief or requests.call)


async def _gone(adapter: Running) -> None:
    """Wait until the adapter has noticed that a peer left, and its name is free."""
    for _ in range(20):
        adapter.context.emit()
        await asyncio.sleep(0.01)


async def check_cancel(kit: AdapterKit) -> None:
    """Check that a call ends when its peer cancels it, and that the peer can begin another one."""
    async with calling(kit, "call", "cancel") as (adapter, requests, peer):
        for _ in range(2):
            call = await _called(adapter, peer, requests.call)
            call.progress(0.5)
            await send(peer, requests.cancel)
            await until(lambda call=call: call.is_done, "a cancelled call goes on")  # type: ignore[misc]
        adapter.assert_alive("a cancelled call")


async def check_time_out(kit: AdapterKit) -> None:
    """Check that a call that takes longer than its peer will wait is cancelled, and that the peer is told."""
    async with calling(kit, "brief") as (adapter, requests, peer):
        call = await _called(adapter, peer, requests.brief)
        await until(lambda: call.is_done, "a call goes on after its time-out")
        await _hears(peer, b"not done within", "a call that took too long")


async def check_flood(kit: AdapterKit) -> None:
    """Check that little is kept for a peer that sends requests without waiting for answers, and that others are served, then and later."""
    async with calling(kit, "many") as (adapter, requests, peer):
        context = adapter.context
        listening = asyncio.ensure_future(_listen(peer))
        try:
            await _flood(peer, requests.many)
            await adapter.connect()
            context.emit()
            await _quiet(adapter)
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)
        adapter.assert_alive("a flood of requests")
        waiting = sum(not call.is_done for call in context.calls)
        assert waiting < FLOOD, (
            f"{waiting} calls of one peer wait for their answer: refuse them above a limit, as Conversation does"
        )
        await peer.close()
        for call in context.calls:
            if not call.is_done:
                call.finish(Reply(1, TICK_NS))
        await _gone(adapter)
        other = await adapter.caller(requests)
        if requests.call:
            await _called(adapter, other, requests.call)


async def _flood(peer: Peer, request: bytes) -> None:
    async def send_all() -> None:
        for _ in range(0, FLOOD, 100):
            await peer.send(request * 100)

    # The adapter may stop reading, or disconnect the peer.
    with contextlib.suppress(OSError, asyncio.TimeoutError):
        await asyncio.wait_for(send_all(), adapter_kit.SETTLE_S)


async def _listen(peer: Peer) -> None:
    while await peer.hear():
        pass


async def _quiet(adapter: Running) -> None:
    """Wait until the adapter has handled everything that was sent to it."""
    stats, loop = adapter.context.stats, asyncio.get_running_loop()
    before, since = -1, loop.time()
    while loop.time() < since + _QUIET_S:
        taken = stats.calls + stats.errors + len(adapter.context.calls)
        if taken != before:
            before, since = taken, loop.time()
        await asyncio.sleep(0.01)


async def check_did_you_mean(kit: AdapterKit) -> None:
    """Check that the answer to a misspelt name suggests the right one."""
    async with calling(kit, "misspelt") as (_, requests, peer):
        await send(peer, requests.misspelt)
        await _hears(peer, b"did you mean", "a misspelt service (the text of `Refused` names the right one)")


async def _hears(peer: Peer, words: bytes, after: str) -> None:
    """Fail unless the peer gets these words in time. Only the end of what it got before them is kept."""
    heard = b""

    async def hear() -> None:
        nonlocal heard
        while words not in heard and (more := await peer.hear()):
            heard = heard[-1000:] + more

    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(hear(), adapter_kit.SETTLE_S)
    assert words in heard, (
        f'the peer is not told "{words.decode()}" after {after}; it heard {heard[-300:]!r}: tell it each refusal'
    )
