"""Sensors that take time, in all modes of time: the same pictures; and what is dropped in real time is dropped by the replay again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from simulation_rig import FREE, PATIENCE_S, Rig
from slow_rig import kind_of, slow_resolved

from uwserver.ports import Sample
from uwserver.recording.recorder import Recorder
from uwserver.recording.replay import replay
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.simulation.clock import SystemTime, Timing

PORT, AGAIN = "rov/slow", "rov/slow/late"
SEERS = "rov/view", "rov/imaging"
SEEING = """
schema = 1
seed = 3
[world]
rate_hz = 240
[seabed]
kind = "flat"
depth_m = 4
[structures.pile]
kind = "cylinder"
radius_m = 0.3
length_m = 4
position_ned_m = [3.0, 0.5, 2.0]
attitude_rpy_deg = [0.0, 90.0, 0.0]
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 2.0]
velocity_frd_mps = [0.3, 0.1, 0.0]
[vehicles.rov.sensors.view]
kind = "camera"
rate_hz = 20
width = 64
height = 48
[vehicles.rov.sensors.imaging]
kind = "multibeam"
rate_hz = 10
range_m = 6
beams = 32
bins = 64
field_deg = 90
beam_width_horizontal_deg = 4
rays_vertical = 32
"""


def recorded(path: Path, resolved: Resolved, timing: Timing, meanwhile: Callable[[Rig], None]) -> list[Sample]:
    """A run that is recorded; returns its samples of the slow sensor."""
    rig = Rig(resolved, timing)
    recorder = Recorder(path, rig.world, resolved)
    with recorder.running(rig.simulation, rig.bus):
        rig.start()
        try:
            meanwhile(rig)
        finally:
            rig.end()
    return [sample for sample in rig.samples if sample.port == PORT]


def until(world: Any, holds: Callable[[], bool]) -> None:
    time, end = SystemTime(), SystemTime().now_ns() + round(PATIENCE_S * 1e9)
    while not holds():
        assert time.now_ns() < end, f"the world stands at tick {world.tick}"
        time.wait(0.005, threading.Event())


def test_drops_of_real_time_are_repeated(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    resolved, path = slow_resolved(tmp_path), tmp_path / "run.mcap"
    found: dict[str, Any] = {}

    def run(rig: Rig) -> None:
        world, computing = rig.world, rig.world.sensor_arrays.computing
        found["world"] = world
        until(world, lambda: world.tick > 20)
        kind_of(world).gate.clear()
        until(world, lambda: computing.dropped.get(PORT, 0) >= 3)  # and time goes on
        kind_of(world).gate.set()
        tick = world.tick
        until(world, lambda: world.tick > tick + 300)

    samples = recorded(path, resolved, Timing(), run)
    dropped = found["world"].sensor_arrays.computing.dropped[PORT]
    assert len([r for r in caplog.records if "was not computed in time" in r.getMessage()]) == 1
    seen = {sample.seq: sample.value for sample in samples}
    assert len(seen) >= 20
    with path.open("rb") as file:
        calls = [m for _, c, m in make_reader(file).iter_messages() if b'"source":"clock"' in m.data]
    assert len(calls) == dropped
    again = replay(path, [tmp_path / "slow.py"])
    assert (again.difference, again.truncated) == (None, False)
    assert again.hashes >= 2
    # Those that were not dropped are the same as in a world that waits.
    free = Rig(resolved, FREE).world
    whole = {s.seq: s.value for s in free.step(max(seen) * 10 + 40) if s.port == PORT}
    free.end("over")
    assert dropped >= 3
    assert all(whole[seq][1] == value[1] for seq, value in seen.items())
    assert set(range(max(seen))) - set(seen)


@pytest.fixture(scope="module")
def metered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Resolved, list[Sample]]:
    """A scenario, and what its slow sensor says in a second of a world that is stepped."""
    resolved = slow_resolved(tmp_path_factory.mktemp("metered"), "metered = true")
    expected = Rig(resolved, FREE).world
    wanted = [s for s in expected.step(240) if s.port in (PORT, AGAIN)]
    expected.end("over")
    return resolved, wanted


@pytest.mark.parametrize("timing", [FREE, Timing(mode="lockstep", lockstep_clients=("me",)), Timing(paused=True)])
def test_all_modes_give_the_same_pictures_and_states(metered: tuple[Resolved, list[Sample]], timing: Timing) -> None:
    resolved, wanted = metered
    rig = Rig(resolved, timing)
    rig.start()
    try:
        rig.simulation.lockstep.barrier.join("me")
        if timing.paused or timing.mode == "lockstep":
            assert rig.call("world/step", n=240).fault is None
        else:
            assert rig.call("world/run_until_tick", tick=240).fault is None
        done = rig.world.tick
    finally:
        rig.end()
    samples = [s for s in rig.samples if s.port in (PORT, AGAIN)]
    assert done >= 240
    assert samples[: len(wanted)] == wanted
    assert rig.world.sensor_arrays.computing.dropped == {}


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[Resolved, dict[tuple[str, int], Sample]]:
    """A scenario, and what its camera and its sonar say in 0.6 s of a world that is stepped."""
    pytest.importorskip("embreex")
    file = tmp_path_factory.mktemp("seeing") / "seeing.toml"
    file.write_text(SEEING)
    resolved = load(file, adapters={})
    free = Rig(resolved, FREE).world
    whole = {(s.port, s.seq): s for s in free.step(144) if s.port in SEERS}
    free.end("over")
    assert {port for port, _ in whole} == set(SEERS)
    return resolved, whole


@pytest.mark.parametrize("timing", [Timing(), FREE, Timing(mode="lockstep", lockstep_clients=("me",))])
def test_a_camera_and_a_sonar_see_the_same_in_all_modes(
    seen: tuple[Resolved, dict[tuple[str, int], Sample]], timing: Timing
) -> None:
    """Bit for bit; in real time but for what was dropped, which shifts no other."""
    resolved, whole = seen
    rig = Rig(resolved, timing)
    rig.start()
    try:
        rig.simulation.lockstep.barrier.join("me")
        if timing.mode == "lockstep":
            assert rig.call("world/step", n=144).fault is None
        else:
            assert rig.call("world/run_until_tick", tick=144).fault is None
    finally:
        rig.end()
    found = [s for s in rig.samples if s.port in SEERS and (s.port, s.seq) in whole]
    if timing.mode == "realtime":
        # What a busy machine did not compute in time is counted, and nothing else is missing.
        assert len(found) + sum(rig.world.sensor_arrays.computing.dropped.values()) >= len(whole) - len(SEERS)
    else:
        assert len(found) == len(whole)
    for sample in found:
        assert sample.value == whole[sample.port, sample.seq].value
        assert sample.t_ns == whole[sample.port, sample.seq].t_ns
