"""Kinds of sensors that a user has written: the step calls their code, or stops for what is in Python."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from uwserver.ports import Sample
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.world import World
from uwserver.world.sensing import python_readings, timetable

PING = '''
from uwserver.physics.kernel.deferred import entry
from uwserver.ports import Field
from uwserver.sensors import Pose, SensorTable
from uwserver.sensors.compiled import SensorKernel, CompiledSensor, begins, p_NS, q_NS, reading_of, record, rotate

class PingConfig(SensorTable, tag="ping", kw_only=True, frozen=True):
    """Downward ray."""
    def build(self, mount: Pose) -> "Ping":
        return Ping(mount)

@entry
def aim(heads, rows, numbers, due, surroundings, t, origin, direction, first, hits):
    count = 0
    for n, k in enumerate(due):
        head = heads[k]
        first[n] = count
        if begins(head):
            origin[count, 0], origin[count, 1], origin[count, 2] = p_NS(head, surroundings)
            direction[count, 0], direction[count, 1], direction[count, 2] = rotate(q_NS(head, surroundings), (0.0, 0.0, 1.0))
            count += 1
    first[len(due)] = count
    return {reach}

@entry
def run(heads, rows, numbers, due, surroundings, t, direction, first, hits):
    for n, k in enumerate(due):
        if heads[k].number > {most}:
            raise ValueError("it has had enough")
        if heads[k].ready:
            reading_of(heads[k], numbers)[0] = hits.distance[first[n]]

class Ping(CompiledSensor):
    doc = "How far the bottom is."
    fields = (Field("range", "m", "of the ray"),)
    kernel = SensorKernel(record([("x", "f8")]), run, (aim,))
    rays = 1

    def __init__(self, mount):
        super().__init__(mount)

SENSORS = (PingConfig,)
'''

DUMP = '''
from uwserver.ports import Buffer, Field
from uwserver.sensors import IdealSensor, Pose, SensorTable

class DumpConfig(SensorTable, tag="dump", kw_only=True, frozen=True):
    """Bytes."""
    def build(self, mount: Pose) -> "Dump":
        return Dump()

class Dump(IdealSensor):
    doc = "Some bytes."
    fields = (Field("data", "1", "whatever it is", type="bytes"),)

    def measure(self, scope):
        return True, [Buffer(data=bytes(8))]

SENSORS = (DumpConfig,)
'''

WORLD = """
schema = 1
extensions = ["kind.py"]
[world]
rate_hz = 240
{bottom}
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.sensors.own]
{own}
"""
BOTTOM = '[seabed]\nkind = "flat"\ndepth_m = 20'


def worlds(folder: Path, code: str, own: str, bottom: str = BOTTOM) -> tuple[World, World]:
    """The same twice."""
    (folder / "kind.py").write_text(code, encoding="utf-8")
    (folder / "world.toml").write_text(WORLD.format(own=own, bottom=bottom), encoding="utf-8")
    resolved = load(folder / "world.toml", adapters={})
    return build(resolved), build(resolved)


def ping(reach: str, most: int = 1 << 40) -> str:
    return PING.replace("{reach}", reach).replace("{most}", str(most))


def one_by_one(world: World, ticks: int) -> list[Sample]:
    return [sample for _ in range(ticks) for sample in world.advance().samples]


@pytest.mark.parametrize("reach", ["50.0", "50"], ids=["float", "whole number"])
@pytest.mark.parametrize("bottom", [BOTTOM, ""], ids=["bottom", "open water"])
def test_rays_of_a_kind_reach_as_far_as_it_says(tmp_path: Path, reach: str, bottom: str) -> None:
    """Also where its code gives another type than ours does."""
    one, other = worlds(tmp_path, ping(reach), 'kind = "ping"\nrate_hz = 60', bottom)
    samples = one_by_one(one, 60)
    assert other.step(60) == samples
    ranges = [sample.value[0] for sample in samples if sample.port == "rov/own"]
    assert len(ranges) == 15
    assert ranges == ([pytest.approx(15.0, abs=0.5)] * 15 if bottom else [math.inf] * 15)
    assert {reason for reason, count in other.stepping.stops.items() if count} <= {"room"}


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (ping("None"), 'cannot compile "aim"'),
        (ping("50.0").replace("(aim,)", "(aim,) * 3"), "3 loops that aim, at most 2"),
    ],
    ids=["nothing", "three"],
)
def test_a_kind_that_cannot_be_called_is_told_where_it_stands(tmp_path: Path, code: str, said: str) -> None:
    with pytest.raises(RuntimeError, match=said) as refused:
        worlds(tmp_path, code, 'kind = "ping"\nrate_hz = 60')
    assert "kind.py" in str(refused.value)


def test_a_kernel_that_raises_ends_the_ticks_where_it_does(tmp_path: Path) -> None:
    one, other = worlds(tmp_path, ping("50.0", 20), 'kind = "ping"\nrate_hz = 60')
    with pytest.raises(ValueError, match="enough"):
        one_by_one(one, 200)
    with pytest.raises(ValueError, match="enough"):
        other.step(200)
    assert one.tick == other.tick
    assert one.t_ns == other.t_ns
    assert one.hydro.state.tobytes() == other.hydro.state.tobytes()
    assert one.sensing.newest("rov/imu") == other.sensing.newest("rov/imu")


def test_what_may_be_large_comes_in_a_tick_by_itself(tmp_path: Path) -> None:
    """Who takes samples gets those of one tick at a time."""
    one, other = worlds(tmp_path, DUMP, 'kind = "dump"\nrate_hz = 10\nlatency_s = 0.05')
    samples, got, most = one_by_one(one, 240), [], 0
    while other.tick < 240:
        before = other.tick
        output = other.advance(most=240 - before)
        most = max(most, other.tick - before)
        begin = other.ticks.time_of(other.tick - 1)
        assert all(begin < sample.t_sent_ns <= other.t_ns for sample in output.made)
        got += output.samples
    assert [(s.port, s.seq, s.t_sent_ns) for s in got] == [(s.port, s.seq, s.t_sent_ns) for s in samples]
    assert sum(sample.port == "rov/own" for sample in got) == 9
    assert most > 5


EVERYTHING = """
schema = 1
seed = 4
[world]
rate_hz = 240
[seabed]
kind = "grid"
file = "bottom.npy"
spacing_m = [1.0, 1.0]
[environment.waves]
spectrum = "jonswap"
significant_height_m = 0.3
peak_period_s = 5
direction_deg = 30
[objects.crate]
kind = "box"
size_m = [0.5, 0.5, 0.5]
density_kgpm3 = 1200
position_ned_m = [3.0, 0.0, 9.74]
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.autopilot]
[vehicles.rov.sensors]
ctd = { kind = "ctd", profile = "sbe49", rate_hz = 16 }
shafts = { kind = "rpm", rate_hz = 20, members = ["t1", "t5"], sigma_radps = 0.5 }
bumper = { kind = "contact", rate_hz = 240 }
lasers = { kind = "range_array", rate_hz = 10, beams = 5, field_of_view_deg = 60, rpy_deg = [0.0, -90.0, 0.0] }
scan = { kind = "scanning_sonar", profile = "ping360", rate_hz = 20, cross_talk_db = -40, streams = { ideal = { ideal = true } } }
profile = { kind = "profiler", rate_hz = 20, rpy_deg = [0.0, -90.0, 0.0], sector_width_deg = 60, streams = { ideal = { ideal = true } } }
paper = { kind = "scanning_sonar", rate_hz = 4, model = "paper", bins = 4096, sees_own_vehicle = true }
dvl = { kind = "dvl", profile = "a50", rate_hz = 8, streams = { ideal = { ideal = true } } }
all = { kind = "compound", rate_hz = 120, members = ["ctd", "lasers", "imu"], streams = { same = { ideal = true } } }
currents = { kind = "adcp", profile = "signature1000", rate_hz = 8, cells = 8, cell_size_m = 0.5, streams = { ideal = { ideal = true } } }
"""


def test_nothing_that_is_numbers_stops_the_step(tmp_path: Path) -> None:
    """Waves, what rests, rays at a mesh, CTD, shafts, bumper, lasers, currents, sonars, and what repeats others; in one go all is as tick by tick."""
    x = np.arange(-20.0, 21.0)
    np.save(tmp_path / "bottom.npy", 10.0 + 0.3 * np.maximum(0.0, np.add.outer(np.abs(x) - 6.0, np.zeros(41))))
    file = tmp_path / "everything.toml"
    file.write_text(EVERYTHING, encoding="utf-8")
    resolved = load(file, adapters={})
    one, other = build(resolved), build(resolved)
    samples = one_by_one(one, 720)
    assert other.step(720) == samples
    assert one.call("world/state_hash") == other.call("world/state_hash")
    assert {reason for reason, count in other.stops.items() if count} == {"room"}
    newest = {sample.port: sample for sample in samples if sample.valid}
    numbers = (
        "ctd",
        "shafts",
        "bumper",
        "lasers",
        "all",
        "all/same",
        *(f"{n}{i}" for n in ("dvl", "currents", "scan", "profile") for i in ("", "/ideal")),
    )
    assert {f"rov/{name}" for name in numbers} <= newest.keys()
    assert any(newest["rov/paper"].value[3])
    assert None not in newest["rov/lasers"].value[0], "five of them meet the bottom"
    assert other.hydro.touching.is_kept, "the crate rests"


def test_what_is_repeated_in_compiled_code_is_what_python_repeats(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    np.save(tmp_path / "bottom.npy", np.full((41, 41), 10.0))
    file = tmp_path / "everything.toml"
    file.write_text(EVERYTHING, encoding="utf-8")
    resolved = load(file, adapters={})
    told = build(resolved).step(480)
    monkeypatch.setattr(timetable, "is_repeated", lambda slot: False)
    monkeypatch.setattr(python_readings, "is_repeated", lambda slot: False)
    other = build(resolved)
    assert other.step(480) == told
    assert other.stops["readings in Python"] >= 240
    ages = {sample.value[0] for sample in told if sample.port == "rov/all"}
    assert len(ages) > 5
    assert all(0.0 <= age < 0.2 for age in ages)


WAVES = """
schema = 1
seed = 4
[world]
rate_hz = 240
[seabed]
kind = "flat"
depth_m = 9
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.sensors.scan]
kind = "scanning_sonar"
rate_hz = 10
bins = 64
output = "OUTPUT"
cross_talk_db = -40
streams = { ideal = { ideal = true }MORE }
"""


@pytest.mark.parametrize("more", ["", ', late = { modifiers = { lag = { kind = "delay", latency_s = 0.3 } } }'])
def test_values_that_are_no_numbers_wait_for_their_samples(tmp_path: Path, more: str) -> None:
    """Complex echoes of compiled code, and what they would be without errors: they have the amplitudes of those that are numbers."""
    told = {}
    for output in ("pressure", "complex"):
        file = tmp_path / f"{output}.toml"
        file.write_text(WAVES.replace("OUTPUT", output).replace("MORE", more), encoding="utf-8")
        samples = build(load(file, adapters={})).step(480)
        told[output] = [sample for sample in samples if sample.port.startswith("rov/scan")]
    assert len(told["complex"]) > 20
    for number, wave in zip(told["pressure"], told["complex"], strict=True):
        assert (number.port, number.seq, number.t_ns, number.valid) == (wave.port, wave.seq, wave.t_ns, wave.valid)
        found = wave.value[3].array()
        assert np.hypot(found[:, 0], found[:, 1]) == pytest.approx(np.array(number.value[3]), rel=1e-6, abs=1e-30)
        assert found[:, 1].any() != number.port.endswith("/ideal")
