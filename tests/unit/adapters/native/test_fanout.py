"""Who gets which sample how often, encoded once; and what becomes of subscriptions when ports change."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import Counter
from collections.abc import Callable
from typing import Any
from unittest.mock import Mock

import msgspec
import pytest
from uwserver_adapters.native import fanout, routes
from uwserver_adapters.native.codec import JsonCodec
from uwserver_adapters.native.messages import Encoding
from uwserver_adapters.native.shares import Share, Subscription, Taken

from uwserver.ports import Event, Field, Port, Sample
from uwserver.ports.decimation import Decimation
from uwserver.testing import FakeContext, sample_of
from uwserver.testing.fake_context import DEPTH, IMU, THRUSTERS


def passed(rate_hz: float | None, times_ns: list[int]) -> list[int]:
    share = Share(Subscription(1, "p", rate_hz, None, "ring"), Taken(lambda: None))
    return [number for number, t_ns in enumerate(times_ns) if share.passes(t_ns)]


def ticks(rate_hz: float, count: int, first: int = 0) -> list[int]:
    """Rounded times of a sensor, as the world computes them."""
    return [round(number * 1e9 / rate_hz) for number in range(first, first + count)]


def test_every_twelfth_of_120_hz_at_10_hz_without_drift() -> None:
    for first, count in ((0, 120_000), *((first, 2400) for first in range(1, 12))):
        assert passed(10.0, ticks(120.0, count, first)) == list(range(0, count, 12))


@pytest.mark.parametrize("rate", [1.0, 7.0, 50.0, 99.9, 119.0])
def test_rate_is_kept_where_it_does_not_divide(rate: float) -> None:
    numbers = passed(rate, ticks(120.0, 120 * 1000))
    assert abs(len(numbers) - rate * 1000) <= 1
    gaps = [b - a for a, b in itertools.pairwise(numbers)]
    assert max(gaps) - min(gaps) <= 1


@pytest.mark.parametrize("rate", [None, 120.0, 1000.0, 1e300])
def test_all_pass_at_the_own_rate_and_above(rate: float | None) -> None:
    assert len(passed(rate, ticks(120.0, 1000))) == 1000


def test_a_gap_does_not_shift_the_phase() -> None:
    times = ticks(120.0, 121)
    del times[12:30]  # the samples of slots 1 and half of 2 are lost
    assert [times[number] for number in passed(10.0, times)] == [
        0,
        *ticks(120.0, 121)[30:31],
        *ticks(120.0, 121)[36::12],
    ]


def test_a_late_sample_is_no_new_beginning() -> None:
    assert passed(10.0, [0, 100_000_000, 50_000_000, 150_000_000, 200_000_000]) == [0, 1, 4]


def test_time_set_back_begins_anew() -> None:
    times = ticks(120.0, 600) + ticks(120.0, 25)
    assert passed(10.0, times) == [*range(0, 600, 12), 600, 612, 624]


def test_encoded_once_a_codec_and_selection(stage: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    made: Counter[tuple[str, int]] = Counter()
    real = routes.encoded_sample

    def counting(encoding: Encoding, form: Any, sample: Sample) -> bytes:
        made[encoding.name, id(form)] += 1
        return real(encoding, form, sample)

    monkeypatch.setattr(routes, "encoded_sample", counting)

    async def scene() -> None:
        theatre = stage()
        plain = [theatre.talker() for _ in range(10)]
        packed = [theatre.talker("msgpack") for _ in range(10)]
        fewer = [theatre.talker() for _ in range(5)]
        for talker in (*plain, *packed):
            await talker.result("subscribe", {"pattern": "rov/imu"})
        for talker in fewer:
            await talker.result("subscribe", {"pattern": "rov/imu", "fields": ["temperature"]})
        theatre.context.emit()
        assert sorted(made.values()) == [1, 1, 1], "one for JSON, one for msgpack, one for the selection"
        assert theatre.context.stats.encoded == 3
        for talker in (*plain, *packed):
            (sample,) = talker.samples()
            assert sample["value"]["temperature"] == 200.0
        for talker in fewer:
            (sample,) = talker.samples()
            assert sample["value"] == {"temperature": 200.0}

    asyncio.run(scene())


def test_one_write_a_tick_and_client(stage: Callable[..., Any]) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "**"})
        writes: list[bytes] = []
        talker.transport.write = writes.append
        theatre.context.emit("rov/imu", "rov/depth", "rov/imu")
        assert [data.count(b"\n") for data in writes] == [3]

    asyncio.run(scene())


def test_overlapping_subscriptions_send_a_sample_once(stage: Callable[..., Any]) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "rov/imu"})
        await talker.result("subscribe", {"pattern": "rov/*", "rate_hz": 1})
        theatre.context.emit()
        assert Counter(sample["port"] for sample in talker.samples()) == {"rov/imu": 1, "rov/depth": 1}
        theatre.context.emit()
        assert Counter(sample["port"] for sample in talker.samples()) == {"rov/imu": 1}
        await talker.result("unsubscribe", {"pattern": "rov/imu"})
        theatre.context.emit()
        assert talker.samples() == []

    asyncio.run(scene())


def test_the_strongest_delivery_counts(stage: Callable[..., Any]) -> None:
    async def scene() -> None:
        theatre = stage(queue_samples=3)
        talker = theatre.talker()
        for delivery in ("latest", "ring", "latest"):
            await talker.result("subscribe", {"pattern": "rov/imu", "delivery": delivery})
        talker.transport.stall()
        theatre.adapter.context.put([sample_of(IMU, seq) for seq in range(3)])
        talker.connection.pause_writing()
        for seq in range(3, 10):
            theatre.context.put([sample_of(IMU, seq)])
        talker.connection.resume_writing()
        talker.transport.drain()
        assert [sample["seq"] for sample in talker.samples()] == [0, 1, 2, 7, 8, 9]

    asyncio.run(scene())


def test_ports_that_change(stage: Callable[..., Any]) -> None:
    async def scene() -> None:
        theatre = stage()
        context = theatre.context
        talkers = [theatre.talker(), theatre.talker()]
        for talker in talkers:
            assert await talker.result("subscribe", {"pattern": "rov/*"}) == {
                "subscription": 1,
                "ports": ["rov/imu", "rov/depth"],
            }
        new = Port("rov/new", "sensor", "new", (Field("x", "m", "new"),), "", 10.0)
        other_imu = Port("rov/imu", "sensor", "imu", (Field("q_NS", "1", "attitude", "NS", (4,)),), "", 10.0)
        context.set_ports([other_imu, new, THRUSTERS])
        context.emit()
        for talker in talkers:
            heard = talker.heard()
            assert heard[0]["params"]["event"] == "ports_changed"
            values = {message["params"]["port"]: message["params"]["value"] for message in heard[1:]}
            assert values == {"rov/imu": {"q_NS": [0.0, 1.0, 2.0, 3.0]}, "rov/new": {"x": 0.0}}
        context.set_ports([])
        context.set_ports([DEPTH])
        for talker in talkers:
            talker.heard()
        context.emit()
        assert [len(talker.samples()) for talker in talkers] == [1, 1]

    asyncio.run(scene())


def test_reset_restarts_the_rates(stage: Callable[..., Any]) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "rov/imu", "rate_hz": 10})
        theatre.context.put([sample_of(IMU, 0, 40_000_000)])
        theatre.context.put([sample_of(IMU, 1, 80_000_000)])
        theatre.context.say(Event("reset", 0, 0, "by the test"))
        theatre.context.put([sample_of(IMU, 0, 0)])
        assert [sample["t_ns"] for sample in talker.samples()] == [40_000_000, 0]

    asyncio.run(scene())


def test_a_sample_that_cannot_be_encoded_harms_no_other(
    stage: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "**"})
        theatre.context.put([Sample("rov/imu", 0, 0, 0, True, (1.0,)), sample_of(DEPTH)])
        assert [sample["port"] for sample in talker.samples()] == ["rov/depth"]
        assert theatre.context.stats.errors == 1

    asyncio.run(scene())
    assert "rov/imu could not be sent" in caplog.text


def test_caches_are_bounded_and_emptied(stage: Callable[..., Any]) -> None:
    async def scene() -> None:
        theatre = stage()
        talker, other = theatre.talker(), theatre.talker("msgpack")
        for _ in range(3):
            await talker.result("describe")
            await other.result("describe")
        assert len(theatre.context.described) == 2, "once a codec"
        for number in range(3 * fanout.CACHED_PATTERNS):
            await talker.result("describe", {"pattern": f"{number}/*"})
            await talker.result("subscribe", {"pattern": f"{number}/*"})
        assert theatre.adapter.service.fanout.described.cache_info().currsize <= fanout.CACHED_PATTERNS
        assert theatre.adapter.service.fanout.covered.cache_info().currsize <= fanout.CACHED_PATTERNS
        assert len((await talker.result("describe"))["ports"]) == 3
        theatre.context.set_ports([DEPTH])
        assert [port["path"] for port in (await talker.result("describe"))["ports"]] == ["rov/depth"]

    asyncio.run(scene())


def test_a_client_that_leaves_leaves_no_route(stage: Callable[..., Any]) -> None:
    async def scene() -> None:
        theatre = stage()
        talkers = [theatre.talker(encoding) for encoding in ("json", "json", "msgpack")]
        for talker in talkers:
            for pattern in ("**", "rov/imu", "rov/*"):
                await talker.result("subscribe", {"pattern": pattern})
        for talker in talkers:
            talker.transport.die()
        await asyncio.sleep(0)
        assert theatre.adapter.service.fanout._ports == {}
        assert theatre.adapter.service.fanout.sessions == {}
        assert theatre.context.stats.peers == 0

    asyncio.run(scene())


def test_the_world_is_told_what_clients_subscribe_to(stage: Callable[..., Any]) -> None:
    async def scene() -> None:
        theatre = stage()
        context = theatre.context
        one, two = theatre.talker(), theatre.talker("msgpack")
        assert context.subscriptions == frozenset()
        await one.result("subscribe", {"pattern": "rov/imu"})
        assert context.subscriptions == {"rov/imu"}
        await two.result("subscribe", {"pattern": "rov/*"})
        assert context.subscriptions == {"rov/imu", "rov/depth"}
        await two.result("unsubscribe", {"pattern": "rov/*"})
        assert context.subscriptions == {"rov/imu"}
        await two.result("subscribe", {"pattern": "rov/d*h"})
        await two.result("subscribe", {"pattern": "*/depth"})
        assert context.subscriptions == {"rov/imu", "rov/depth"}
        new = msgspec.structs.replace(DEPTH, path="rov2/depth")
        context.set_ports([IMU, DEPTH, new, THRUSTERS])
        assert context.subscriptions == {"rov/imu", "rov/depth", "rov2/depth"}
        two.transport.die()
        await asyncio.sleep(0)
        assert context.subscriptions == {"rov/imu"}

    asyncio.run(scene())


def test_the_world_is_told_what_is_enough_for_clients_together(stage: Callable[..., Any]) -> None:
    """After some ticks with samples, of all that have begun meanwhile; and at once that it is enough no more."""

    async def scene() -> None:
        theatre = stage()
        context, routes = theatre.context, theatre.adapter.service.fanout
        follow, followed = context.subscriptions_changed, list[Any]()
        context.subscriptions_changed = lambda: (follow(), followed.append(dict(routes.decimations)))[0]
        one, two = theatre.talker(), theatre.talker("msgpack")
        await one.result("subscribe", {"pattern": "rov/*", "rate_hz": 10})
        assert followed.pop() == {}, "nothing is known before the first sample"
        context.put([sample_of(IMU, 0, 50)])
        for k in range(fanout.UPDATE_TICKS - 1):
            assert followed == []
            context.put([sample_of(DEPTH, k, 70 + k)])
        assert followed == [{"rov/imu": (Decimation(10.0, 50),), "rov/depth": (Decimation(10.0, 70),)}]
        await two.result("subscribe", {"pattern": "rov/imu"})
        assert followed.pop() == {"rov/depth": (Decimation(10.0, 70),)}
        two.transport.die()
        await asyncio.sleep(0)
        assert followed.pop().keys() == {"rov/imu", "rov/depth"}
        context.say(Event("reset", 0, 0, "by the test"))
        assert routes.decimations == {}

    asyncio.run(scene())


def _far_and_wide() -> tuple[fanout.Fanout, Any]:
    """A client with 200 subscriptions to everything, in a world with 300 sensors."""
    ports = {f"v{n}/depth": msgspec.structs.replace(DEPTH, path=f"v{n}/depth") for n in range(300)}
    routes = fanout.Fanout(FakeContext(ports=ports))
    client: Any = Mock(codec=JsonCodec(), subscriptions={})
    routes.admit(client)
    for serial in range(200):
        client.subscriptions[serial] = Subscription(serial, "**", None, None, "ring")
        routes.add(client, client.subscriptions[serial])
    return routes, client


def test_a_client_with_many_subscriptions_leaves_quickly() -> None:
    """Two seconds of the loop went by with 256 of them to 600 ports: each was looked for among all."""
    routes, client = _far_and_wide()
    start = time.thread_time()
    routes.dismiss(client)
    assert time.thread_time() - start < 0.2
    assert routes._ports == {}


def test_what_all_subscriptions_of_a_client_cover_is_bounded(
    stage: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each sample is compared with all of them: 256 that cover 600 ports took 35 ms for the samples of one tick."""
    monkeypatch.setattr(fanout, "COVERED", 7)

    async def scene() -> None:
        theatre = stage()
        talker, other = theatre.talker(), theatre.talker()
        most = theatre.adapter.service.fanout.most_covered()
        assert most == max(7, 2 * len(theatre.context.ports))
        for _ in range(most // 2):
            await talker.result("subscribe", {"pattern": "rov/*"})
        for pattern in ("rov/*", "rov/imu") if most % 2 == 0 else ("rov/*",):
            code, text = await talker.fault("subscribe", {"pattern": pattern})
            assert code == "overload"
            assert f"cover {most} ports at most" in text
        await other.result("subscribe", {"pattern": "rov/*"})
        await talker.result("unsubscribe", {"pattern": "rov/*"})
        await talker.result("subscribe", {"pattern": "rov/*"})

    asyncio.run(scene())


def test_a_world_with_many_ports_may_be_heard_twice() -> None:
    ports = {f"v{n}/depth": msgspec.structs.replace(DEPTH, path=f"v{n}/depth") for n in range(fanout.COVERED)}
    assert fanout.Fanout(FakeContext(ports=ports)).most_covered() == 2 * fanout.COVERED


def test_who_subscribes_does_not_wait_for_forms(stage: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """They took 2 ms with 600 ports; each is made with the first sample, and once."""
    made: list[str] = []
    form = routes.SampleForm
    monkeypatch.setattr(routes, "SampleForm", lambda port, fields: (made.append(port.path), form(port, fields))[1])

    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "**"})
        assert made == []
        for _ in range(2):
            theatre.context.emit("rov/imu")
        assert made == ["rov/imu"]

    asyncio.run(scene())
