"""Paths of sound and packets of modems are measured."""

from __future__ import annotations

import pytest
from uwserver_bench.engine import acoustics

from uwserver.environment.acoustics.boundaries import Boundaries
from uwserver.environment.acoustics.channel import channel_of
from uwserver.environment.column import WaterColumn
from uwserver.ports.crossing import TickOutput
from uwserver.world.world import World


def test_a_row_for_the_first_and_one_for_all() -> None:
    rows = acoustics.bench_sound(quick=True, say=lambda line: None)
    assert len(rows) == 2 * len(acoustics.CASES)
    assert {row.at_most for row in rows} == {60.0, 1000.0}
    assert all(len(row.values) == 2 and min(row.values) > 0.0 for row in rows)


def test_what_is_measured_finds_rays() -> None:
    counts = []
    for water, x, a, b in acoustics.CASES.values():
        channel = channel_of(WaterColumn(water, 9.81, 1025.0), acoustics.FREQUENCY_HZ)
        counts.append(len(channel.paths(x, a, b, Boundaries(acoustics.BOTTOM_M))))
        assert channel.earliest(x, a, b, Boundaries(acoustics.BOTTOM_M)) is not None
    assert min(counts) >= 5
    assert counts[1] > 10


def test_a_row_for_silence_and_one_for_a_packet(monkeypatch) -> None:
    """They are differences of what a clock shows, which on a busy machine may be anything: here a tick takes 40 us, with modems 43, and in one
    in which a modem has something to hear 500 more."""
    monkeypatch.setattr(acoustics, "VEHICLES", 3)
    spent_ns, advance = [0], World.advance

    def timed(world: World) -> TickOutput:
        modems_here = [path for path in world.sensors if "modem" in path]
        before = heard(world, modems_here)
        output = advance(world)
        spent_ns[0] += 43_000 if modems_here else 40_000
        spent_ns[0] += 500_000 * (heard(world, modems_here) - before)
        return output

    monkeypatch.setattr(World, "advance", timed)
    monkeypatch.setattr(acoustics.time, "thread_time_ns", lambda: spent_ns[0])
    rows = acoustics.bench_modems(quick=True, say=lambda line: None)
    assert [row.at_most for row in rows] == [5.0, 1000.0]
    assert rows[0].values == pytest.approx((3.0, 3.0))
    assert rows[1].values == pytest.approx((500.0, 500.0))


def heard(world: World, ports: list[str]) -> int:
    """Packets that arrived so far."""
    return sum(world.call(f"{port}/get")["counts"]["heard"] for port in ports)


def test_everybody_hears_the_packet(monkeypatch) -> None:
    monkeypatch.setattr(acoustics, "VEHICLES", 3)
    world = acoustics.fleet()
    acoustics._packet_us(world, 2, 0.0)
    heard = [world.call(f"v{k}/modem/received/get")["counts"]["heard"] for k in range(3)]
    assert heard == [1, 1, 2]
    assert not [path for path in acoustics.fleet(with_modems=False).sensors if "modem" in path]
