"""Saved states from strangers: damaged, cut, spliced, and forged with a check sum that fits. Each is refused whole, or can run.

Some hundred each day, and 10^5 in the slow run.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from dice import seed_of_the_day

import uwserver
from uwserver.ports import Refused
from uwserver.world.state import snapshot
from uwserver.world.world import Diverged, World

MANY = pytest.mark.slow
DAMAGED = (300, pytest.param(47_000, marks=MANY))  # for each of two scenarios
FORGED = (400, pytest.param(3_000, marks=MANY))
SPECIAL: list[Any] = [math.nan, math.inf, -math.inf, 1e308, -1e308, 0.0, -1, 0, 2**63 - 1, -(2**63), 2**31]
SPECIAL += ["", "x" * 5000, "../x", b"", b"\xff" * 64, None, True, [], {}]


@pytest.fixture(scope="module", params=["rov_autopilot", "one_of_everything"])
def world(request: pytest.FixtureRequest) -> World:
    world = uwserver.load(request.param).core
    world.step(300)
    return world


@pytest.fixture(scope="module")
def saved(world: World) -> bytes:
    return snapshot.to_bytes(world, snapshot.take(world))


def sealed(body: bytes) -> bytes:
    return body + hashlib.sha256(body).digest()


@pytest.mark.parametrize("count", DAMAGED)
def test_damage_is_always_seen(world: World, saved: bytes, count: int) -> None:
    rng = np.random.default_rng(seed_of_the_day())
    before = snapshot.take(world).hash()
    for _ in range(count):
        data = bytearray(saved)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] ^= 1 << int(rng.integers(0, 8))
        if rng.random() < 0.1:
            del data[int(rng.integers(0, len(data))) :]
        if bytes(data) == saved:
            continue
        with pytest.raises(Refused):
            snapshot.from_bytes(world, bytes(data))
    assert snapshot.take(world).hash() == before


@pytest.mark.parametrize("count", FORGED)
def test_a_forged_state_is_refused_whole_or_can_run(world: World, saved: bytes, count: int) -> None:
    rng = np.random.default_rng(seed_of_the_day())
    raw = msgspec.msgpack.decode(saved[:-32])
    refused = ran = 0
    for k in range(count):
        forged = _flipped(saved[:-32], rng) if k % 4 == 0 else msgspec.msgpack.encode(_changed(raw, rng))
        before = snapshot.take(world).hash()
        try:
            snapshot.from_bytes(world, sealed(forged))
        except Refused:
            refused += 1
            assert snapshot.take(world).hash() == before, "a refused state has changed something"
            continue
        ran += 1
        with contextlib.suppress(Diverged):
            world.step(2)
        snapshot.from_bytes(world, saved)
    assert refused > count / 4
    assert ran > count / 30, "the mutations are too coarse to show anything"


def _flipped(body: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(body)
    data[int(rng.integers(0, len(data)))] ^= 1 << int(rng.integers(0, 8))
    return bytes(data)


def _changed(value: Any, rng: np.random.Generator) -> Any:
    """The same tree with one leaf or branch replaced; records in bytes are opened too."""
    if isinstance(value, dict) and value:
        key = list(value)[int(rng.integers(0, len(value)))]
        if rng.random() < 0.02:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: _changed(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.95:
        k = int(rng.integers(0, len(value)))
        return [*value[:k], _changed(value[k], rng), *value[k + 1 :]]
    if isinstance(value, bytes) and value and rng.random() < 0.9:
        return _changed_bytes(value, rng)
    if isinstance(value, float) and rng.random() < 0.5:
        return value * float(rng.choice([0.5, -1.0, 1e3, 1e200]))
    return SPECIAL[int(rng.integers(0, len(SPECIAL)))]


def _changed_bytes(value: bytes, rng: np.random.Generator) -> bytes:
    try:
        inner = msgspec.msgpack.decode(value)
        if isinstance(inner, dict) and inner:
            return msgspec.msgpack.encode(_changed(inner, rng))
    except (ValueError, RecursionError):  # these bytes are no record: a picture may look like lists in lists in lists
        pass
    if len(value) >= 8 and len(value) % 8 == 0:
        array = np.frombuffer(value).copy()
        array[int(rng.integers(0, len(array)))] = rng.choice([math.nan, math.inf, 0.0, 1e300, -1.0, 5e-324])
        return array.tobytes()
    return value[: int(rng.integers(0, len(value)))]
