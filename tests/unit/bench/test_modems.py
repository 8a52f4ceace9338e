"""What is measured is what the report says: silent modems, and packets that everybody hears."""

from __future__ import annotations

import pytest
from uwserver_bench import cli, modems

from uwserver.ports.crossing import TickOutput
from uwserver.world.world import World


def test_a_row_for_silence_and_one_for_a_packet(monkeypatch) -> None:
    """They are differences of what a clock shows, which on a busy machine may be anything: here a tick takes 40 us, with modems 43, and in one
    in which a modem has something to hear 500 more."""
    monkeypatch.setattr(modems, "VEHICLES", 3)
    spent_ns, advance = [0], World.advance

    def timed(world: World) -> TickOutput:
        modems_here = [path for path in world.sensors if "modem" in path]
        before = heard(world, modems_here)
        output = advance(world)
        spent_ns[0] += 43_000 if modems_here else 40_000
        spent_ns[0] += 500_000 * (heard(world, modems_here) - before)
        return output

    monkeypatch.setattr(World, "advance", timed)
    monkeypatch.setattr(modems.time, "thread_time_ns", lambda: spent_ns[0])
    rows = modems.bench_modems(quick=True, say=lambda line: None)
    assert [row.at_most for row in rows] == [5.0, 1000.0]
    assert rows[0].values == pytest.approx((3.0, 3.0))
    assert rows[1].values == pytest.approx((500.0, 500.0))
    assert "modems" in cli._MODULES["sensors"]


def heard(world: World, ports: list[str]) -> int:
    """Packets that arrived so far."""
    return sum(world.call(f"{port}/get")["counts"]["heard"] for port in ports)


def test_everybody_hears_the_packet(monkeypatch) -> None:
    monkeypatch.setattr(modems, "VEHICLES", 3)
    world = modems.fleet()
    modems._packet_us(world, 2, 0.0)
    heard = [world.call(f"v{k}/modem/received/get")["counts"]["heard"] for k in range(3)]
    assert heard == [1, 1, 2]
    assert not [path for path in modems.fleet(with_modems=False).sensors if "modem" in path]
