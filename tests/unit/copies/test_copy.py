"""Where the arrays of copies lie: in their places, again after a reset with another seed; constants of the first copy where they are alike."""

import gc

import numpy as np
import pytest
from copies_rig import check_equal

import uwserver
from uwserver.copies.batch import Batch
from uwserver.copies.copy import _CONSTANT, Copy
from uwserver.physics.kernel import layout
from uwserver.scenario.builder import ScenarioBuilder

NAMES = list(layout.WORLD)


def noisy():
    """Water that moves, errors, delays, rays and a battery."""
    b = ScenarioBuilder("noisy", seed=5, rate_hz=240).current(velocity_ned_mps=[0.1, 0.0, 0.0])
    b.add_current("gusts", "gauss_markov", sigma_ned_mps=[0.1, 0.1, 0.02], tau_s=2.0)
    b.waves(significant_height_m=0.5, peak_period_s=5, components=4)
    b.vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3])
    b.sensor("rov", "imu", "imu", rate_hz=60, profile="mems_imu")
    b.sensor("rov", "ahrs", "attitude", rate_hz=40, profile="mems_ahrs")
    b.sensor("rov", "dvl", "dvl", rate_hz=8, profile="a50")
    b.sensor("rov", "cell", "battery", rate_hz=2, profile="lipo_4s_18ah")
    b.modifier("rov", "ahrs", "late", "delay", latency_s=0.05, jitter_s=0.03)
    return b.build()


def samples(batch, k):
    return {port: (batch.read(port).stamps[k].tolist(), batch.read(port).packed[k].tobytes()) for port in batch.ports}


def places(batch, k):
    """Addresses and lengths of all that a run of copy k writes."""
    return [(array.ctypes.data, array.nbytes) for array in batch._copies[k]._live if array.nbytes]


def addresses(batch, name):
    """Where compiled code finds an array of each copy."""
    return [int(copy.world.hydro.table[NAMES.index(name), 0]) for copy in batch._copies]


def ground(batch, k):
    memory = batch._memory
    return memory._bytes[k * memory._size : (k + 1) * memory._size]


@pytest.mark.parametrize(
    ("k", "threads"),
    [(0, 3), (1, 1), pytest.param(0, 1, marks=pytest.mark.slow), pytest.param(1, 3, marks=pytest.mark.slow)],
)
def test_a_copy_with_another_seed_is_what_load_gives_of_it_and_the_others_go_on(k, threads):
    """Also the first, of whose constants the others read, and whose world nobody else has any longer."""
    batch = uwserver.batch(noisy(), 3, threads=threads)
    worlds = [uwserver.load(noisy(), seed=5 + i) for i in range(3)]
    batch.command("rov/thrusters", u=np.full(8, 0.4))
    for world in worlds:
        world.command("rov/thrusters", u=[0.4] * 8)
        world.step(70)
    batch.step(70)
    others = [i for i in range(3) if i != k]
    before = [(batch.states()[i].tobytes(), samples(batch, i), places(batch, i)) for i in others]
    mine = places(batch, k)
    batch.reset([k], seeds=77)
    gc.collect()
    assert before == [(batch.states()[i].tobytes(), samples(batch, i), places(batch, i)) for i in others]
    assert places(batch, k) == mine
    assert batch.ticks.tolist() == [0 if i == k else 70 for i in range(3)]
    worlds[k] = uwserver.load(noisy(), seed=77)
    check_equal(batch, k, worlds[k])
    for _ in range(8):
        batch.command("rov/thrusters", u=np.full(8, -0.3))
        batch.step(37)
        for i, world in enumerate(worlds):
            world.command("rov/thrusters", u=[-0.3] * 8)
            world.step(37)
            check_equal(batch, i, world)
    batch.close()


def test_all_that_a_run_writes_lies_in_the_place_of_its_copy():
    batch = uwserver.batch(noisy(), 3)
    for turn in range(3):
        for k in range(3):
            live = [array for array in batch._copies[k]._live if array.nbytes]
            assert all(np.shares_memory(array, ground(batch, k)) for array in live)
            assert not any(np.shares_memory(array, ground(batch, (k + 1) % 3)) for array in live)
            assert all(array.ctypes.data % 64 == 0 for array in live)
            hydro = batch._copies[k].world.hydro
            for name in ("state", "bodies", "thrusters", "flows", "forces"):
                address = addresses(batch, name)[k]
                assert address == getattr(hydro, name).ctypes.data, name
        batch.step(30)
        batch.reset([turn], seeds=100 + turn)
        batch.step(30)


def test_copies_that_need_more_memory_than_the_first_run_all_the_same(monkeypatch):
    """Then some of their arrays lie elsewhere, and after a reset elsewhere again."""
    monkeypatch.setattr(Copy, "size", property(lambda copy: 64 * 40))
    batch = uwserver.batch(noisy(), 3)
    live = [array for array in batch._copies[1]._live if array.nbytes]
    within = [np.shares_memory(array, ground(batch, 1)) for array in live]
    assert any(within)
    assert not all(within)
    for seed in (6, 60, 61):
        world = uwserver.load(noisy(), seed=seed)
        batch.reset([1], seeds=seed)
        gc.collect()
        batch.command("rov/thrusters", u=np.full(8, 0.4))
        world.command("rov/thrusters", u=[0.4] * 8)
        batch.step(100)
        world.step(100)
        check_equal(batch, 1, world)


def test_a_copy_has_the_work_space_of_the_thread_that_steps_it():
    """Not of its own: so much less goes through the caches."""
    batch = uwserver.batch(noisy(), 5, threads=3)
    batch.step(12)
    spaces = batch._steps._scratch.ctypes.data + layout.SCRATCH.itemsize * np.arange(3)
    assert addresses(batch, "scratch") == spaces[[0, 0, 1, 1, 2]].tolist()
    assert layout.SCRATCH["apart"].itemsize >= 64
    batch.close()


def test_constants_are_read_of_the_first_copy_where_they_are_alike():
    batch = uwserver.batch(noisy(), 3)
    batch.reset([2], seeds=9)
    for name in _CONSTANT:
        assert len(set(addresses(batch, name))) == 1, name
    for name in ("state", "bodies", "thrusters", "flows"):
        assert len(set(addresses(batch, name))) == 3, name


def sluggish(seed):
    """A world whose thrusters do less the higher its seed is: of seed 5 as the scenario says."""
    world = uwserver.load(noisy(), seed=seed)
    for name in ("G", "D"):
        world.hydro.lags[name] *= 5.0 / seed
    return world


def other_table(seed):
    """A world whose thrusters are twice as strong, but for seed 5."""
    world = uwserver.load(noisy(), seed=seed)
    world.hydro.tables["force"] *= 1.0 if seed == 5 else 2.0
    return world


@pytest.mark.parametrize(("build", "name"), [(sluggish, "lags"), (other_table, "tables")])
def test_each_copy_goes_by_its_own_constants_where_they_differ(build, name):
    seeds = [5, 8, 5, 10]
    batch, worlds = Batch(build, seeds), [build(seed) for seed in seeds]
    table = addresses(batch, name)
    own = [getattr(copy.world.hydro, name).ctypes.data for copy in batch._copies]
    shared = batch._constants[name].ctypes.data
    assert table == [shared, own[1], shared, own[3]]
    others = set(_CONSTANT) - {name}
    assert all(len(set(addresses(batch, other))) == 1 for other in others)
    batch.command("rov/thrusters", u=np.array([0.3, 0.3, -0.3, -0.3, 0, 0, 0, 0]))
    batch.step(120)
    for k, world in enumerate(worlds):
        world.command("rov/thrusters", u=[0.3, 0.3, -0.3, -0.3, 0, 0, 0, 0])
        world.step(120)
        check_equal(batch, k, world)
    assert batch.states()[1, 7] != batch.states()[0, 7]


def test_a_copy_that_is_built_anew_gets_or_leaves_the_constants_of_the_first():
    """Those of the batch's first world, whatever has become of that copy."""
    batch = Batch(sluggish, [5, 8, 5])
    shared = batch._constants["lags"].ctypes.data
    assert addresses(batch, "lags")[0] == shared
    batch.reset(seeds=[8, 5, 10])
    gc.collect()
    own = [copy.world.hydro.lags.ctypes.data for copy in batch._copies]
    assert addresses(batch, "lags") == [own[0], shared, own[2]]
    worlds = [sluggish(seed) for seed in (8, 5, 10)]
    batch.command("rov/thrusters", u=np.full(8, 0.3))
    batch.step(100)
    for i, world in enumerate(worlds):
        world.command("rov/thrusters", u=[0.3] * 8)
        world.step(100)
        check_equal(batch, i, world)
