"""Messages with fields of any value, whole and broken: nothing raises, nothing wild reaches the world, heartbeats go on."""

from __future__ import annotations

import asyncio
import math
import struct

import numpy as np
import pytest

pymavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")

ROUNDS = 20
EDGES = {
    "float": (0.0, -0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, 0.5, 400.0, 21196.0),
    "double": (0.0, math.nan, math.inf),
}


def some_value(rng: np.random.Generator, kind: str, name: str) -> float | int:
    if kind in EDGES:
        return (
            float(rng.choice(EDGES[kind])) if rng.random() < 0.6 else float(rng.normal() * 10.0 ** rng.integers(-3, 8))
        )
    if name.startswith("target"):
        return int(rng.choice((0, 1, 1, 1, 1, 7)))
    bits = {"char": 8}.get(kind) or int("".join(c for c in kind.removesuffix("_mavlink_version") if c.isdigit()))
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if kind.startswith("int") else (0, (1 << bits) - 1)
    if rng.random() < 0.5:
        return int(rng.choice((low, high, min(high, 1), 0)))
    return min(high, max(low, int(rng.integers(0, 300))))


def any_message(rng: np.random.Generator, definition: type) -> object:
    values: list[object] = []
    for name, kind in zip(definition.fieldnames, definition.fieldtypes, strict=True):  # type: ignore[attr-defined]
        count = definition.array_lengths[definition.ordered_fieldnames.index(name)]  # type: ignore[attr-defined]
        if kind == "char" and count:
            values.append(bytes(rng.integers(0, 256, count, np.uint8)))
        elif count:
            values.append([some_value(rng, kind, name) for _ in range(count)])
        else:
            values.append(some_value(rng, kind, name))
    return definition(*values)


TAKEN = (
    "HEARTBEAT COMMAND_LONG COMMAND_INT SET_MODE MANUAL_CONTROL RC_CHANNELS_OVERRIDE PARAM_REQUEST_LIST PARAM_REQUEST_READ PARAM_SET "
    "FILE_TRANSFER_PROTOCOL REQUEST_DATA_STREAM MISSION_COUNT MISSION_ITEM_INT MISSION_ITEM MISSION_REQUEST_LIST MISSION_REQUEST_INT "
    "MISSION_REQUEST MISSION_CLEAR_ALL MISSION_SET_CURRENT SET_POSITION_TARGET_LOCAL_NED SET_POSITION_TARGET_GLOBAL_INT "
    "SET_ATTITUDE_TARGET SET_GPS_GLOBAL_ORIGIN TIMESYNC SYSTEM_TIME PING"
)


@pytest.mark.parametrize("name", TAKEN.split())
async def test_fields_of_any_value(make_bench, name):
    rng = np.random.default_rng(sum(name.encode()))
    bench = make_bench(frames_per_s=100_000, origin_deg=None if len(name) % 2 else (63.0, 10.0))
    bench.rov.state["mode"] = "guided"
    station = bench.station()
    definition = getattr(pymavlink, f"MAVLink_{name.lower()}_message")
    for _ in range(ROUNDS):
        try:
            data = any_message(rng, definition).pack(station.mav)  # type: ignore[attr-defined]
        except struct.error:
            continue
        bench.router.receive(station.channel, data)
        bench.run(0.05)
        await asyncio.sleep(0)
    for command in bench.rov.commands:
        assert all(math.isfinite(x) for field in command.value if field is not None for x in field)
    bench.vehicle.parameters.set("MAV1_EXTRA1", 10.0)
    fresh = bench.station(254)
    bench.run(1.2)
    assert fresh.of("HEARTBEAT")
    assert fresh.of("ATTITUDE")


def test_every_other_message_of_the_dialect(make_bench):
    rng = np.random.default_rng(7)
    bench = make_bench(frames_per_s=100_000)
    station = bench.station()
    for definition in pymavlink.mavlink_map.values():
        if definition.msgname not in (*TAKEN.split(), "SETUP_SIGNING"):
            try:
                data = any_message(rng, definition).pack(station.mav)  # type: ignore[attr-defined]
            except struct.error:
                continue
            bench.router.receive(station.channel, data)
    bench.run(1.5)
    assert station.of("HEARTBEAT")
    assert not bench.rov.commands


def test_broken_bytes(make_bench):
    rng = np.random.default_rng(8)
    bench = make_bench(frames_per_s=100_000)
    station = bench.station()
    good = b"".join(station.bytes_of("COMMAND_LONG", 1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0) for _ in range(20))
    for _ in range(200):
        broken = bytearray(good)
        for at in rng.integers(0, len(broken), 12):
            broken[at] = rng.integers(0, 256)
        cut = int(rng.integers(0, len(broken)))
        bench.router.receive(station.channel, bytes(broken[:cut]))
        bench.router.receive(station.channel, bytes(broken[cut:]))
    bench.run(1.5)
    assert station.of("HEARTBEAT")
    assert bench.counters["checksum"] > 100
