"""A sample is encoded once an encoding, be there one client or ten, and not at all for none: on every transport, through real sockets."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest
from uwserver_adapters.sockets import SocketsAdapter
from uwserver_bench.net.net_processes import HAS_ZENOH
from uwserver_bench.net.wires import Peer, ask, connect

from uwserver.adapter import SampleForm
from uwserver.testing import FakeContext

PATIENCE_S = 60.0
TICKS = 5


@pytest.fixture
def shaped(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """How often the values of a port were shaped for an encoder."""
    count: Counter[str] = Counter()
    real, encodable = SampleForm.value, SampleForm.encodable

    def counting(self: SampleForm, sample: Any, binary: bool = False) -> Any:
        count[sample.port] += 1
        return real(self, sample, binary)

    def once(self: SampleForm, sample: Any, binary: bool = False) -> Any:
        before = count[sample.port]
        shaped = encodable(self, sample, binary)  # which may be by `value`
        count[sample.port] = before + 1
        return shaped

    monkeypatch.setattr(SampleForm, "value", counting)
    monkeypatch.setattr(SampleForm, "encodable", once)
    return count


@contextlib.asynccontextmanager
async def running(adapter: type[Any], **table: Any) -> AsyncIterator[FakeContext]:
    context, ready = FakeContext(), asyncio.Event()
    task = asyncio.create_task(adapter(adapter.Config(**table), context).run(ready))
    try:
        await asyncio.wait_for(ready.wait(), PATIENCE_S)
        yield context
    finally:
        task.cancel()
        await asyncio.wait([task], timeout=PATIENCE_S)


def received(peer: Peer, port: str, count: int) -> list[dict[str, Any]]:
    """The next samples of a port."""
    found: list[dict[str, Any]] = []
    for _ in range(int(PATIENCE_S / 0.05)):
        messages = [m.body for m in peer.receive(0.05) if m.body.get("method") == "sample"]
        found += [body["params"] for body in messages if body["params"]["port"] == port]
        if len(found) >= count:
            return found
    raise AssertionError(f"{len(found)} of {count} samples came")


def play(
    adapter: type[Any], table: dict[str, Any], wires: dict[str, int], shaped: Counter[str], encodings: int
) -> None:
    """So many clients on each wire take all samples of `TICKS` ticks; `encodings` is how often each may be encoded."""

    async def scene() -> None:
        async with running(adapter, **table) as context:
            address = {"UDP": str(context.stats.details.get("udp", "")), "zenoh": context.stats.address}
            with contextlib.ExitStack() as stack:
                peers = []
                for wire, count in wires.items():
                    for _ in range(count):
                        peer = await asyncio.to_thread(connect, wire, address.get(wire, context.stats.address))
                        peers.append(stack.enter_context(contextlib.closing(peer)))
                        await asyncio.to_thread(ask, peer, "subscribe", pattern="rov/imu")
                # Over zenoh a subscription reaches the server a moment later.
                while not context.stats.encoded:
                    context.emit("rov/imu")
                    await asyncio.sleep(0.05)
                await asyncio.sleep(0.2)
                shaped.clear()
                encoded = context.stats.encoded
                sent = [context.emit("rov/imu")[0] for _ in range(TICKS)]
                assert shaped == {"rov/imu": encodings * TICKS}
                assert context.stats.encoded - encoded == encodings * TICKS
                context.emit("rov/depth")
                assert shaped["rov/depth"] == 0, "encoded though nobody takes it"
                for peer in peers:
                    got: list[Any] = []
                    while not got or got[-1]["seq"] < sent[-1].seq:
                        got += await asyncio.to_thread(received, peer, "rov/imu", 1)
                    assert [s["seq"] for s in got[-TICKS:]] == [s.seq for s in sent]
                    assert tuple(got[-1]["value"]["f_S"]) == sent[-1].value[0]

    asyncio.run(asyncio.wait_for(scene(), 3 * PATIENCE_S))


@pytest.mark.parametrize("clients", [1, 10])
@pytest.mark.parametrize(
    ("wires", "encodings"),
    [
        (("TCP JSON",), 1),
        (("TCP msgpack",), 1),
        (("WebSocket",), 1),
        (("UDP",), 1),
        (("TCP JSON", "WebSocket", "UDP"), 1),
        (("TCP JSON", "TCP msgpack"), 2),
    ],
    ids=["TCP JSON", "TCP msgpack", "WebSocket", "UDP", "all JSON", "JSON and msgpack"],
)
def test_sockets(shaped, wires, encodings, clients):
    play(SocketsAdapter, {"port": 0, "udp_port": 0}, dict.fromkeys(wires, clients), shaped, encodings)


@pytest.mark.skipif(not HAS_ZENOH, reason="eclipse-zenoh is not installed")
@pytest.mark.parametrize("clients", [1, 10])
@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_zenoh(shaped, encoding, clients):
    from uwserver_adapters.zenoh_bus import ZenohAdapter

    play(ZenohAdapter, {"listen": ("tcp/127.0.0.1:0",), "encoding": encoding}, {"zenoh": clients}, shaped, 1)


@pytest.mark.skipif(not HAS_ZENOH, reason="eclipse-zenoh is not installed")
def test_zenoh_encodes_for_nobody_only_what_is_asked_for(shaped):
    import zenoh
    from uwserver_adapters.zenoh_bus import ZenohAdapter

    def newest(endpoint: str) -> list[Any]:
        text = '{{mode: "client", connect: {{endpoints: ["{}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
        with zenoh.open(zenoh.Config.from_json5(text.format(endpoint))) as session:
            return [json.loads(reply.ok.payload.to_bytes()) for reply in session.get("uw/*/rov/imu", timeout=5)]

    async def scene() -> None:
        async with running(ZenohAdapter, listen=("tcp/127.0.0.1:0",)) as context:
            for _ in range(100):
                context.emit()
            assert not shaped
            assert context.stats.encoded == context.stats.samples_sent == 0
            (value,) = await asyncio.to_thread(newest, context.stats.address)
            assert "f_S" in value
            assert shaped == {"rov/imu": 1}

    asyncio.run(asyncio.wait_for(scene(), PATIENCE_S))
