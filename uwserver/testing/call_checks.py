"""The part of the conformance suite that calls services: what becomes of a call whose peer leaves, cancels, floods, or misspells."""

from __future__ import annotations

import asyncio
import contextlib

from uwserver.ports import Fault, Reply
from uwserver.testing import adapter_kit
from uwserver.testing.adapter_kit import AdapterKit, Peer, Running, running, send, until
from uwserver.testing.fake_context import TICK_NS, HeldCall

CALLED = "world/run_until"
"""The service of `FakeContext` that the checks call: its answers wait for the suite."""
FLOOD = 5000
"""Requests of one peer that waits for no answer."""
_QUIET_S = 0.5


async def _called(adapter: Running, peer: Peer, request: bytes) -> HeldCall:
    """Send a call and wait until it has reached the world."""
    context = adapter.context
    before = len(context.calls)
    await send(peer, request)
    await until(lambda: len(context.calls) > before, f"the call {request[:60]!r} does not reach the world")
    return context.calls[-1]


async def check_leaves_in_the_middle_of_a_call(kit: AdapterKit) -> None:
    """Nobody waits for the long-running call of a peer that has gone: it ends, at its time-out at the latest, and what the world still says
    of it disturbs nobody."""
    requests = kit.requests
    if requests is None:
        return
    async with running(kit) as adapter:
        adapter.context.held.add(CALLED)
        peer = await adapter.caller(requests)
        call = await _called(adapter, peer, requests.brief or requests.call)
        await peer.close()

        def has_ended() -> bool:
            adapter.context.emit()  # on TCP, who has gone looks like who only listens on, until something is written to it
            return call.is_done

        await until(has_ended, "the call of a peer that has left goes on: close its Conversation, or cancel the call")
        call.progress(0.5)
        call.finish(Reply(1, TICK_NS, fault=Fault("preempted", "too late")))
        adapter.context.emit()
        adapter.assert_alive("a peer that left in the middle of a call")
        await _called(adapter, await adapter.caller(requests), requests.brief or requests.call)


async def check_cancel(kit: AdapterKit) -> None:
    """A call that its peer cancels ends, and the peer can begin another."""
    requests = kit.requests
    if requests is None or not requests.cancel:
        return
    async with running(kit) as adapter:
        adapter.context.held.add(CALLED)
        peer = await adapter.caller(requests)
        for _ in range(2):
            call = await _called(adapter, peer, requests.call)
            call.progress(0.5)
            await send(peer, requests.cancel)
            await until(lambda call=call: call.is_done, "a cancelled call goes on")  # type: ignore[misc]
        adapter.assert_alive("a cancelled call")


async def check_time_out(kit: AdapterKit) -> None:
    """A call that takes longer than its peer would wait is cancelled, and the peer is told."""
    requests = kit.requests
    if requests is None or not requests.brief:
        return
    async with running(kit) as adapter:
        adapter.context.held.add(CALLED)
        peer = await adapter.caller(requests)
        call = await _called(adapter, peer, requests.brief)
        await until(lambda: call.is_done, "a call goes on after its time-out")
        await _hears(peer, b"not done within", "a call that took too long")


async def check_flood(kit: AdapterKit) -> None:
    """A peer that sends requests and waits for no answer: what is kept for it is bounded, and others are served, then and later."""
    requests = kit.requests
    if requests is None or not requests.many:
        return
    async with running(kit) as adapter:
        context = adapter.context
        context.held.add(CALLED)
        peer = await adapter.caller(requests)
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
        for _ in range(20):  # until it has noticed who left, and the name is free
            context.emit()
            await asyncio.sleep(0.01)
        await _called(adapter, await adapter.caller(requests), requests.call)


async def _flood(peer: Peer, request: bytes) -> None:
    async def send_all() -> None:
        for _ in range(0, FLOOD, 100):
            await peer.send(request * 100)

    with contextlib.suppress(OSError, asyncio.TimeoutError):  # to read no further, or to disconnect it, is right
        await asyncio.wait_for(send_all(), adapter_kit.SETTLE_S)


async def _listen(peer: Peer) -> None:
    while await peer.hear():
        pass


async def _quiet(adapter: Running) -> None:
    """Wait until the adapter has taken all that was sent."""
    stats, loop = adapter.context.stats, asyncio.get_running_loop()
    before, since = -1, loop.time()
    while loop.time() < since + _QUIET_S:
        taken = stats.calls + stats.errors + len(adapter.context.calls)
        if taken != before:
            before, since = taken, loop.time()
        await asyncio.sleep(0.01)


async def check_did_you_mean(kit: AdapterKit) -> None:
    """A name that is nearly right is answered with the right one."""
    requests = kit.requests
    if requests is None or not requests.misspelt:
        return
    async with running(kit) as adapter:
        peer = await adapter.caller(requests)
        await send(peer, requests.misspelt)
        await _hears(peer, b"did you mean", "a misspelt service (the text of `Refused` names the right one)")


async def _hears(peer: Peer, words: bytes, after: str) -> None:
    heard = await _heard(peer, words)
    assert words in heard, (
        f'the peer is not told "{words.decode()}" after {after}; it heard {heard[-300:]!r}: tell it each refusal'
    )


async def _heard(peer: Peer, words: bytes) -> bytes:
    """The end of what a peer hears until these words came, or it was disconnected, or they did not come in time."""
    heard = b""

    async def hear() -> None:
        nonlocal heard
        while words not in heard and (more := await peer.hear()):
            heard = heard[-1000:] + more

    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(hear(), adapter_kit.SETTLE_S)
    return heard
