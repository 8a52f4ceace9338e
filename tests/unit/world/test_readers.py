"""What lets sensors of a kind read is made when sensors come or go, and reads on with the same arrays in each tick."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import uwserver
from uwserver.physics.kernel.arrays import IntArray
from uwserver.sensors.bank import Bank
from uwserver.world.instruments import Instruments
from uwserver.world.world import World

SCENARIO = """
schema = 1
seed = 3
[world]
rate_hz = 240
[seabed]
kind = "flat"
depth_m = 12
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.sensors]
# A ping is not over when the next is due; another listens 60 m far, so that their numbers of rays change from tick to tick.
sounder = { kind = "altimeter", profile = "ping1d", rate_hz = 60 }
far = { kind = "altimeter", rate_hz = 24, max_range_m = 60 }
dvl = { kind = "dvl", profile = "a50", rate_hz = 10 }
"""


@pytest.fixture
def world(tmp_path: Path) -> World:
    file = tmp_path / "pings.toml"
    file.write_text(SCENARIO)
    return uwserver.load(file)


def values(world: World, ticks: int) -> list[Any]:
    return [(s.port, s.seq, s.t_ns, s.valid, s.value) for s in world.step(ticks)]


def test_rays_cast_with_arrays_of_before_hit_the_same(world: World, tmp_path: Path, monkeypatch: Any) -> None:
    kept = values(world, 240)
    other = uwserver.load(tmp_path / "pings.toml")
    made = Instruments.reader

    def fresh(self: Instruments, bank: Bank, due: IntArray) -> Callable[[float], None]:
        def read(t: float) -> None:
            made(self, bank, due)(t)

        return read

    monkeypatch.setattr(Instruments, "reader", fresh)
    other.refresh()
    assert kept == values(other, 240)
    assert {port for port, *_, valid, _ in kept if valid} >= {"rov/sounder", "rov/far", "rov/dvl"}


def test_a_tick_makes_no_readers(world: World, monkeypatch: Any) -> None:
    values(world, 120)
    made = []
    monkeypatch.setattr(Instruments, "reader", lambda *args: made.append(args))
    values(world, 120)
    assert made == []


def test_sensors_that_come_move_the_arrays_of_the_others(world: World, tmp_path: Path) -> None:
    values(world, 10)
    alone = uwserver.load(tmp_path / "pings.toml")
    values(alone, 10)
    for k in range(3):
        world.call("world/spawn", name=f"r{k}", like="rov", p_NB=[20.0 * k + 20.0, 0.0, 5.0])
    assert [value for value in values(world, 120) if value[0].startswith("rov/")] == values(alone, 120)
