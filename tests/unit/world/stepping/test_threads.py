"""Threads of a world: its numbers are the same with any, and a trial finds out whether they pay."""

import gc
import hashlib
import threading

import pytest

import uwserver
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.places import FUTEX
from uwserver.physics.kernel.team import ALONE, Team
from uwserver.world.stepping import threads
from uwserver.world.stepping.threads import BLOCKS, LEAST_BODIES, Threads, Trial

pytestmark = pytest.mark.skipif(not FUTEX, reason="threads wait in compiled code on Linux alone")

SWARM = """
schema = 1
title = "A swarm that touches the bottom and itself"
seed = 6
[world]
rate_hz = 240
threads = {threads}
[environment]
density_kgpm3 = 1025
[environment.current]
velocity_ned_mps = [0.1, 0.05, 0.0]
[seabed]
kind = "flat"
depth_m = 20.0
[vehicles.rov]
model = "bluerov2_heavy"
copies = {{ count = 36, columns = 6, spacing_m = [0.6, 0.5] }}
position_ned_m = [0.0, 0.0, 19.82]
[vehicles.rov.autopilot]
[vehicles.rov.sensors.ahrs]
kind = "attitude"
profile = "mems_ahrs"
rate_hz = 60
[vehicles.rov.sensors.dvl]
kind = "dvl"
profile = "a50"
rate_hz = 8
position_frd_m = [-0.1, 0.0, 0.1]
[vehicles.rov.sensors.battery]
kind = "battery"
profile = "lipo_4s_18ah"
rate_hz = 2
"""


def world_with(count, tmp_path):
    path = tmp_path / f"swarm_{count}.toml"
    path.write_text(SWARM.format(threads=count))
    return uwserver.load(path).core


def run(world, ticks):
    """Hashes of the states and readings, and the most contacts of a tick."""
    world.subscribe(())
    for name in world.vehicles:
        world.call(f"{name}/autopilot/arm")
    digest, touching = hashlib.sha256(), 0
    for _ in range(ticks // 20):
        world.step(20)
        digest.update(world.hydro.state.tobytes())
        digest.update(world.hydro.contact_nu_dot.tobytes())
        digest.update(world.sensor_arrays.numbers.rows.tobytes())
        touching = max(touching, len(world.hydro.touched.impulse))
    return digest.hexdigest(), touching


def compare(ticks, tmp_path, counts):
    found = {}
    for count in counts:
        world = world_with(count, tmp_path)
        assert world.threads.count == count
        found[count], touching = run(world, ticks)
        assert touching > 10
        world.end("over")
        assert world.threads.count == 1
    assert len(set(found.values())) == 1


def test_the_numbers_are_those_of_one_thread(tmp_path):
    compare(400, tmp_path, (1, 3))


@pytest.mark.slow
def test_the_numbers_are_those_of_one_thread_for_long(tmp_path):
    compare(100_000, tmp_path, (1, 2, 3))


def kernel_threads():
    gc.collect()
    return [t.name for t in threading.enumerate() if t.name.startswith("uwserver-kernels")]


def test_a_small_world_begins_no_thread():
    world = uwserver.load("bluerov2_pool").core
    assert kernel_threads() == []
    assert world.threads.trial is None
    assert world.hydro.team is ALONE


def test_threads_end_with_the_run(tmp_path):
    world = world_with(2, tmp_path)
    assert kernel_threads() == ["uwserver-kernels-1"]
    world.end("over")
    assert kernel_threads() == []
    world.step(2)


def test_a_world_that_is_dropped_leaves_no_thread(tmp_path):
    world = world_with(2, tmp_path)
    world.step(2)
    del world
    assert kernel_threads() == []


class Steps:
    """A clock that a test moves."""

    def __init__(self):
        self.now = 0

    def __call__(self):
        return self.now


@pytest.mark.parametrize(("shared", "pays"), [(50, True), (96, True), (98, False), (200, False)])
def test_a_trial_takes_what_is_faster(shared, pays):
    clock, team = Steps(), Team(2)
    team.begin()
    trial, ticks = Trial(team, 10, clock), 0
    over = False
    while not over:
        trial.begin_tick()
        # The first blocks are slow, and now and then a tick is.
        clock.now += (shared if team.shares else 100) + (1000 if ticks < 20 or ticks == 57 else 0)
        over = trial.end_tick()
        ticks += 1
    assert ticks == 10 * BLOCKS
    assert team.shares == pays
    team.end()


class Bodies(Hydrodynamics):
    """So many, without any row."""

    def __init__(self, count):
        super().__init__((), 0.01)
        self.count = count

    def __len__(self):
        return self.count


@pytest.fixture
def settled(monkeypatch):
    monkeypatch.setattr(threads, "why_alone", lambda: "")
    made = []

    def settle(count, wanted):
        made.append(Threads(Bodies(count), 16, lambda: 0))
        made[-1].use(wanted)
        made[-1].bodies_changed()
        return made[-1]

    yield settle
    for each in made:
        each.end()


def test_auto_tries_two_threads_where_there_are_enough_bodies(settled):
    assert settled(LEAST_BODIES - 1, "auto").trial is None
    some = settled(LEAST_BODIES, "auto")
    assert some.trial is not None
    first, some.trial = some.trial, None
    some.bodies_changed()
    assert some.trial is None
    some._hydro.count += 1
    some.bodies_changed()
    assert some.trial is not first
    assert some.trial is not None


def test_auto_is_one_thread_where_a_second_is_of_no_use(settled, monkeypatch):
    monkeypatch.setattr(threads, "why_alone", lambda: "one core")
    assert settled(100, "auto").trial is None
    assert settled(100, 2).count == 2


def test_a_number_is_taken_as_it_is(settled):
    three = settled(LEAST_BODIES, 3)
    assert (three.count, three.trial, len(three._hydro.scratch)) == (3, None, 3)
    assert settled(LEAST_BODIES, 1).count == 1
    with pytest.raises(ValueError, match="1 to 16 threads, not 17"):
        settled(1, 17)


def test_bodies_that_went_back_to_other_arrays_get_the_team_again(settled):
    two = settled(LEAST_BODIES, 2)
    hydro = two._hydro
    kept = hydro.arrays()
    hydro.set_team(ALONE, 1)
    two.bodies_changed()
    assert hydro.team is kept["team"]
