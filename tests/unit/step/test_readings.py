"""Readings in the step: sensors of a kind read on where their arrays lie elsewhere, and what they would read without errors is read as if it had not
been."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import uwserver
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
    return uwserver.load(file).core


def values(world: World, ticks: int) -> list[Any]:
    return [(s.port, s.seq, s.t_ns, s.valid, s.value) for s in world.step(ticks)]


def test_sensors_that_come_move_the_arrays_of_the_others(world: World, tmp_path: Path) -> None:
    values(world, 10)
    alone = uwserver.load(tmp_path / "pings.toml").core
    values(alone, 10)
    for k in range(3):
        world.call("world/spawn", name=f"r{k}", like="rov", p_NB=[20.0 * k + 20.0, 0.0, 5.0])
    assert [value for value in values(world, 120) if value[0].startswith("rov/")] == values(alone, 120)


def test_what_is_asked_for_without_errors_changes_no_other_reading(world: World, tmp_path: Path) -> None:
    """Nor its time: a ping that would begin anew in the shadow of another is none. And nothing stops for it."""
    file = tmp_path / "both.toml"
    imu = '[vehicles.rov.sensors]\nimu = { kind = "imu", rate_hz = 120 }\n'
    both = SCENARIO.replace("[vehicles.rov.sensors]\n", imu)
    both = both.replace(" }\n", ", streams = { ideal = { ideal = true } } }\n")
    file.write_text(both)
    twice = uwserver.load(file).core
    told = values(twice, 480)
    mine = [value for value in told if not value[0].endswith("/ideal")]
    assert [value for value in mine if value[0] != "rov/imu"] == [
        value for value in values(world, 480) if value[0] != "rov/imu"
    ]
    ideal = {
        port: [entry for entry in told if entry[0] == f"{port}/ideal"]
        for port in ("rov/sounder", "rov/far", "rov/dvl", "rov/imu")
    }
    for port, entries in ideal.items():
        own = [entry for entry in mine if entry[0] == port]
        assert [entry[1:3] for entry in entries] == [entry[1:3] for entry in own]
        assert entries != own
    ranges = [value[0] for _, _, _, valid, value in ideal["rov/sounder"] if valid]
    assert max(ranges) - min(ranges) < 0.2, "it sinks or rises slowly, and has no noise"
    assert {reason for reason, count in twice.stepping.stops.items() if count} <= {"room"}


MANY = """
schema = 1
seed = 1
[world]
rate_hz = 240
[vehicles.v]
model = "bluerov2_heavy"
copies = { count = 12, columns = 6, spacing_m = [4.0, 4.0] }
position_ned_m = [0.0, 0.0, 10.0]
[vehicles.v.autopilot]
[vehicles.v.sensors]
dvl = { kind = "dvl", profile = "a50", rate_hz = 6 }
b1 = { kind = "compound", members = ["imu"], rate_hz = 240 }
b2 = { kind = "compound", members = ["imu"], rate_hz = 240 }
b3 = { kind = "compound", members = ["imu"], rate_hz = 240 }
b4 = { kind = "compound", members = ["imu"], rate_hz = 240 }
b5 = { kind = "compound", members = ["imu"], rate_hz = 240 }
"""


def test_none_is_lost_where_room_is_made_amid_a_tick(tmp_path: Path) -> None:
    """Compounds are delivered after the others of their tick, and there are many at once at the first."""
    file = tmp_path / "many.toml"
    file.write_text(MANY)
    some, whole = uwserver.load(file).core, uwserver.load(file).core
    wanted = {f"{name}/{port}" for name in ("v_3", "v_7", "v_12") for port in ("imu", "b1")}
    some.subscribe(wanted)
    for _ in range(12):
        assert [s for s in whole.step() if s.port in wanted] == some.step()


def test_a_scene_that_comes_later_is_seen_at_once(world: World, tmp_path: Path) -> None:
    """One is made by the first spawn into open water, also if that is refused."""
    file = tmp_path / "open.toml"
    file.write_text(SCENARIO.replace("[seabed]\n", "").replace('kind = "flat"\ndepth_m = 12\n', ""))
    alone = uwserver.load(file).core
    assert not [port for port, *_, valid, _ in values(alone, 60) if valid and port == "rov/sounder"]
    assert world.scene is not None
    alone.set_scene(world.scene)
    assert [port for port, *_, valid, _ in values(alone, 60) if valid and port == "rov/sounder"]
