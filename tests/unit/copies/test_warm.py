"""Loops over copies are compiled before the first step, and by their own module."""

import subprocess
import sys

import numpy as np
import pytest

import uwserver
from uwserver.copies import start, warm
from uwserver.physics.kernel import compiled
from uwserver.physics.kernel.compiled import CacheState
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.world import builds

ALL = {"copies", "fitted copies", "sea of copies", "sensors of copies", "soundings of copies", "autopilots of copies"}


def everything():
    b = ScenarioBuilder("everything", seed=3, rate_hz=240).current(velocity_ned_mps=[0.1, 0.0, 0.0])
    b.waves(significant_height_m=0.5, peak_period_s=5, components=4)
    b.vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3], autopilot={"mode": "depth_hold", "armed": True})
    b.truth("rov", rate_hz=10)
    b.sensor("rov", "ahrs", "attitude", rate_hz=40, profile="mems_ahrs")
    b.sensor("rov", "dvl", "dvl", rate_hz=8, profile="a50")
    b.sensor("rov", "sonar", "altimeter", rate_hz=5, profile="ping1d")
    b.sensor("rov", "cell", "battery", rate_hz=2, profile="lipo_4s_18ah")
    return b.build()


def plain():
    b = ScenarioBuilder("plain", rate_hz=240)
    b.vehicle("rov", "bluerov2_heavy_von_benzon", position_ned_m=[0, 0, 3])
    return b.build()


def test_every_stage_has_its_kernels_and_its_time():
    assert warm.SECONDS.keys() == warm.KERNELS.keys() == ALL | {"free copies"}
    names = [name for stage in warm.KERNELS for name in warm.OF_COPIES.kernels_of(stage)]
    assert len(set(names)) == len(names) > 30
    assert not set(names) & {name for stage in builds.STAGES for name in builds.kernels_of(stage)}


def test_what_a_batch_calls_is_what_was_compiled():
    """Else the first steps compile kernels for other types, and those that are ready serve nobody."""
    for stage in warm.KERNELS:
        warm.load(stage)
    batch = uwserver.batch(everything(), 3)
    batch.call("rov/autopilot/set_mode", [0], mode="manual")
    batch.step(240)
    other = uwserver.batch(plain(), 2)
    other.command("rov/thrusters", u=np.zeros(8))
    other.step(24)
    for each in (batch, other):
        each.states()
        assert all(len(each.read(port).seq) == each.n for port in each.ports)
    found = {
        kernel.py_func.__qualname__: kernel.signatures for stage in warm.KERNELS for kernel, _ in warm.KERNELS[stage]()
    }
    assert found
    assert {name: len(signatures) for name, signatures in found.items()} == dict.fromkeys(found, 1)


@pytest.mark.parametrize(("scenario", "stages"), [(everything, ALL), (plain, {"copies", "free copies"})])
def test_a_batch_has_its_stages_compiled_before_it_begins(scenario, stages, monkeypatch):
    asked = []
    monkeypatch.setattr(start, "prepare", lambda *given: asked.append((given[0], given[2])))
    batch = uwserver.batch(scenario(), 2)
    assert (asked, batch.ticks.tolist()) == ([(stages, warm.OF_COPIES)], [0, 0])


def test_they_are_compiled_by_processes_of_their_module(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "cache_state", CacheState(tmp_path, ""))
    started, said = [], []

    def begin(stages, nice=0, module=""):
        started.append((*stages, module))
        return subprocess.Popen([sys.executable, "-c", ""], stdin=subprocess.PIPE)

    monkeypatch.setattr(builds, "start", begin)
    assert builds.prepare(("copies", "free copies"), lambda *line: said.append(line), warm.OF_COPIES)
    assert started == [("free copies", "uwserver.copies.warm"), ("copies", "uwserver.copies.warm")]
    assert "0 of 2 parts ready, about 8 s left" in said[0][0]


def test_a_process_of_the_module_keeps_what_it_has_compiled():
    """The smallest of the stages; where it was there already, nothing is compiled."""
    process = builds.start(["sea of copies"], module=warm.OF_COPIES.module)
    try:
        assert process.wait(120) == 0
    finally:
        builds.stop(process)
    if compiled.cache_state.folder is not None and not compiled.cache_state.reason:
        assert builds.missing(("sea of copies",), warm.OF_COPIES) == ()
