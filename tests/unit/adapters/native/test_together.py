"""Samples that are encoded in one go: the same bytes in the same order as one by one, where that can be, and one by one where it cannot."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from uwserver_adapters.native import fanout
from uwserver_adapters.native.codec import Codec, JsonCodec
from uwserver_adapters.native.messages import Notice

from uwserver.modifiers.columns import columns_of
from uwserver.ports import Event, Field, Port
from uwserver.ports.sample_batch import Origin, SampleBatch, SampleLog
from uwserver.step.streams import ENTRY
from uwserver.testing.fake_context import DEPTH, IMU, THRUSTERS

STATE = Port(
    "rov/state",
    "sensor",
    "state",
    (
        Field("mode", "1", "Mode.", type="str"),
        Field("count", "1", "Count.", type="int"),
        Field("armed", "1", "Armed.", type="bool"),
        Field("P", "m^2", "Covariance.", shape=(2, 2)),
    ),
    "State.",
)
PORTS = (IMU, DEPTH, STATE)
STEP_NS = 20_000_000


def batch(ticks: int = 20, mode: str = "manual") -> SampleBatch:
    """Each port in each tick, with a missing number now and then; they fill a log from its second place on."""
    columns = [columns_of(port.fields) for port in PORTS]
    origins = {k: Origin(port.path, c.width, c.values) for k, (port, c) in enumerate(zip(PORTS, columns, strict=True))}
    log = SampleLog(np.zeros(3 * ticks + 1, ENTRY), np.zeros(1 + ticks * sum(c.width for c in columns)))
    rng, at, place = np.random.default_rng(1), 1, 1
    for n in range(ticks):
        for k, c in enumerate(columns):
            values: list[Any] = []
            for field in c.fields:
                numbers = tuple(rng.normal(size=field.size).tolist())
                value: Any = numbers if field.shape else numbers[0]
                values.append({"str": mode, "int": n << 54, "bool": n % 3 == 0}.get(field.type, value))
            if n % 5 == 0:
                values[-1] = None
            log.entries[place] = ((n + 1) * STEP_NS, 0, k, n, n * STEP_NS, n % 4 != 0, at)
            c.pack(values, log.numbers[at : at + c.width])
            if c.loose:
                log.loose[place] = c.loose_of(values)
            at, place = at + c.width, place + 1
    return SampleBatch(origins, log, 1, place, ticks)


@pytest.fixture
def encoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many messages were encoded in one go, each time."""
    counts: list[int] = []
    for kind in (Codec, JsonCodec):
        monkeypatch.setattr(
            kind, "together", lambda self, messages, real=kind.together: (counts.append(len(messages)), real(self, messages))[1]
        )  # fmt: skip
    return counts


def played(stage: Callable[..., Any], scene: Callable[[Any, fanout.Fanout], Any]) -> None:
    async def play() -> None:
        theatre = stage()
        theatre.context.set_ports((*PORTS, THRUSTERS))
        await scene(theatre, theatre.adapter.service.fanout)

    asyncio.run(play())


def put(routes: fanout.Fanout, samples: SampleBatch, one_by_one: bool = False) -> None:
    (routes.put_samples if one_by_one else routes.put_batch)(samples)
    routes.send_samples()


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_a_client_gets_the_same_as_one_by_one(
    stage: Callable[..., Any], encoding: str, encoded: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fanout, "TOGETHER", 13)
    heard = []

    async def scene(one_by_one: bool, theatre: Any, routes: fanout.Fanout) -> None:
        talker = theatre.talker(encoding)
        await talker.result("subscribe", {"pattern": "rov/imu", "rate_hz": 10.0, "delivery": "latest"})
        await talker.result("subscribe", {"pattern": "rov/depth", "delivery": "latest"})
        await talker.result("subscribe", {"pattern": "rov/state", "rate_hz": 20.0, "delivery": "latest"})
        for part in batch().parts(3) if one_by_one else [batch()]:
            put(routes, part, one_by_one)
        heard.append(talker.transport.take())
        stats = theatre.context.stats
        assert stats.encoded == stats.samples_sent == 4 + 20 + 8
        assert stats.dropped == 0

    for one_by_one in (True, False):
        played(stage, partial(scene, one_by_one))
    assert heard[0] == heard[1]
    assert len(heard[0]) > 3000
    assert (sum(encoded), len(encoded)) == (32, 5)


def test_what_waits_goes_before(stage: Callable[..., Any], encoded: list[int]) -> None:
    async def scene(theatre: Any, routes: fanout.Fanout) -> None:
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "**"})
        (session,) = routes.sessions
        session.outbox.put_reply(session.codec.message(Notice("event", Event("paused", 1, 1, "first"))))
        put(routes, batch(2))
        messages = talker.heard()
        assert [message["method"] for message in messages] == ["event", *["sample"] * 6]
        assert encoded == [6]

    played(stage, scene)


def test_of_several_clients_each_gets_what_it_takes(stage: Callable[..., Any], encoded: list[int]) -> None:
    async def scene(theatre: Any, routes: fanout.Fanout) -> None:
        one, other = theatre.talker(), theatre.talker("msgpack")
        await one.result("subscribe", {"pattern": "rov/imu"})
        await one.result("subscribe", {"pattern": "rov/state"})
        await other.result("subscribe", {"pattern": "rov/depth"})
        put(routes, batch(3))
        assert [len(talker.samples()) for talker in (one, other)] == [6, 3]
        assert encoded == [6, 3], "each has ports of its own"
        await other.result("subscribe", {"pattern": "rov/imu"})
        put(routes, batch(3))
        assert [len(talker.samples()) for talker in (one, other)] == [6, 6]
        assert encoded == [6, 3], "two take a port"

    played(stage, scene)


def test_messages_for_several_clients_are_made_in_one_pass(
    stage: Callable[..., Any], encoded: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many there are, values become objects once."""
    passes: list[int] = []
    values = SampleBatch.values
    monkeypatch.setattr(
        SampleBatch, "values", lambda self, entries: (passes.append(len(entries)), values(self, entries))[1]
    )  # fmt: skip

    async def scene(theatre: Any, routes: fanout.Fanout) -> None:
        talkers = [theatre.talker(encoding) for encoding in ("msgpack", "json", "msgpack")]
        for talker, port in zip(talkers, PORTS, strict=True):
            await talker.result("subscribe", {"pattern": port.path, "rate_hz": 25.0})
        put(routes, batch(7))
        heard = [talker.samples() for talker in talkers]
        assert [[sample["port"] for sample in each] for each in heard] == [[port.path] * 4 for port in PORTS]
        assert (passes, encoded) == ([21], [4, 4, 4])

    played(stage, scene)


def test_who_takes_nothing_more_is_not_sent_to(stage: Callable[..., Any], encoded: list[int]) -> None:
    async def scene(theatre: Any, routes: fanout.Fanout) -> None:
        talker = theatre.talker()
        number = (await talker.result("subscribe", {"pattern": "**"}))["subscription"]
        put(routes, batch(1))
        await talker.result("unsubscribe", {"subscription": number})
        await talker.result("subscribe", {"pattern": "rov/imu", "fields": ["w_S"]})
        put(routes, batch(1))
        assert [list(sample["value"]) for sample in talker.samples()] == [["w_S"]]
        assert encoded == [3], "ports without a taker, and a choice of fields, go one by one"

    played(stage, scene)


def test_to_who_reads_slowly_they_wait_as_subscribed(stage: Callable[..., Any], encoded: list[int]) -> None:
    async def scene(theatre: Any, routes: fanout.Fanout) -> None:
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "**", "delivery": "latest"})
        put(routes, batch(1))
        talker.samples()
        talker.connection.pause_writing()
        put(routes, batch(4))
        assert theatre.context.stats.dropped == 9
        talker.connection.resume_writing()
        assert [sample["seq"] for sample in talker.samples()] == [3, 3, 3]
        assert encoded == [3]

    played(stage, scene)


def test_what_cannot_be_encoded_is_an_error_and_the_client_stays(stage: Callable[..., Any]) -> None:
    async def scene(theatre: Any, routes: fanout.Fanout) -> None:
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "**"})
        put(routes, batch(1, mode="\ud800"))
        assert theatre.context.stats.errors == 1
        assert [sample["port"] for sample in talker.samples()] == ["rov/imu", "rov/depth"], (
            "the others of that turn are sent"
        )
        put(routes, batch(1))
        assert len(talker.samples()) == 3

    played(stage, scene)
