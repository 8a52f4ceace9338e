"""Where the arrays of copies lie: in lines of their own, again after a reset with another seed; equal constants are those of the first copy."""

from __future__ import annotations

import gc
from itertools import pairwise

import numpy as np
import pytest
from copies_rig import check_equal

import uwserver
from uwserver.copies.batch import Batch
from uwserver.copies.copy import _CONSTANT, LINE, Copy, Memory, lines
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
    worlds = [uwserver.load(noisy(), seed=5 + i).core for i in range(3)]
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
    worlds[k] = uwserver.load(noisy(), seed=77).core
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
        world = uwserver.load(noisy(), seed=seed).core
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
    world = uwserver.load(noisy(), seed=seed).core
    for name in ("G", "D"):
        world.hydro.lags[name] *= 5.0 / seed
    return world


def other_table(seed):
    """A world whose thrusters are twice as strong, but for seed 5."""
    world = uwserver.load(noisy(), seed=seed).core
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


RECORD = np.dtype([("number", np.int64), ("place", np.float64, (3,)), ("flag", np.uint8)])


def records(n):
    rows = np.zeros(n, RECORD)
    rows["number"], rows["flag"] = np.arange(n) + 7, 1
    rows["place"] = np.arange(3 * n).reshape(n, 3) / 3
    return rows


def arrays():
    """Of all forms that a world has, with nan, odd lengths and nothing at all."""
    return [
        np.array([1.5, np.nan, -0.0]),
        records(5),
        np.zeros((0, 13)),
        np.arange(26.0).reshape(2, 13),
        np.zeros(0, RECORD),
        np.arange(7, dtype=np.uint8),
        np.array([-(2**62)]),
        np.arange(24).reshape(2, 3, 4),
        records(1),
    ]


def size_of(given):
    return sum(lines(array.nbytes) for array in given)


def same(placed, given):
    return (
        placed.dtype == given.dtype
        and placed.shape == given.shape
        and placed.flags.c_contiguous
        and placed.flags.writeable
        and placed.tobytes() == given.tobytes()
    )


def span(array):
    """Addresses of its first byte and of the one behind its last."""
    return array.ctypes.data, array.ctypes.data + array.nbytes


@pytest.mark.parametrize(("count", "needed"), [(0, 0), (1, 64), (63, 64), (64, 64), (65, 128), (6400, 6400)])
def test_lines_are_whole(count, needed):
    assert (lines(count), LINE) == (needed, 64)


def test_what_is_placed_is_the_same_in_other_memory():
    given = arrays()
    place = Memory(1, size_of(given)).of(0)
    for array in given:
        placed = place(array)
        assert same(placed, array)
        assert not np.shares_memory(placed, array)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_no_array_shares_a_line_with_another_or_with_another_copy(n):
    given = arrays()
    memory = Memory(n, size_of(given))
    placed = [place(array) for place in [memory.of(i) for i in range(n)] for array in given]
    there = sorted(span(array) for array in placed if array.nbytes)
    assert all(first % 64 == 0 for first, _ in there)
    assert all(lines(end) <= first for (_, end), (first, _) in pairwise(there))
    for array in placed:
        array.reshape(-1).view(np.uint8)[:] = 255
        assert sum((other.reshape(-1).view(np.uint8) == 255).all() for other in placed if other.nbytes) == (
            1 if array.nbytes else 0
        )
        array.reshape(-1).view(np.uint8)[:] = 0


def test_arrays_of_a_copy_lie_side_by_side_and_those_of_the_next_behind_them():
    given = arrays()
    memory = Memory(3, size_of(given))
    there = [span(place(array)) for place in [memory.of(i) for i in range(3)] for array in given if array.nbytes]
    assert all(first == lines(end) for (_, end), (first, _) in pairwise(there))


def test_places_begin_anew_when_they_are_asked_for_again_and_those_of_others_stay():
    given = arrays()
    memory = Memory(2, size_of(given))
    (mine, others), again = [[place(array) for array in given] for place in (memory.of(0), memory.of(1))], memory.of(0)
    anew = [again(array) for array in mine[::-1]][::-1]
    for array, other in zip(given, others, strict=True):
        assert same(other, array)
    assert min(span(a)[0] for a in anew if a.nbytes) == min(span(a)[0] for a in mine if a.nbytes)


def test_what_is_placed_where_it_lies_already_stays_what_it_is():
    """A copy that is moved again, in the same order."""
    given = arrays()
    memory = Memory(1, size_of(given))
    for _ in range(2):
        place = memory.of(0)
        given = [place(array) for array in given]
    assert all(same(array, wanted) for array, wanted in zip(given, arrays(), strict=True))


@pytest.mark.parametrize("room", [0, 64, 128, 192])
def test_what_is_too_large_has_memory_of_its_own_and_what_fits_still_comes_in(room):
    memory = Memory(2, room)
    place, beside = memory.of(0), memory.of(1)
    small, large = np.arange(8.0), np.arange(32.0)
    other = beside(small)
    placed = [place(array) for array in (small, large, small + 1, records(3), small + 2)]
    for array, wanted in zip(placed, (small, large, small + 1, records(3), small + 2), strict=True):
        assert same(array, wanted)
    assert same(other, small)
    for k, array in enumerate(placed):
        assert not any(np.shares_memory(array, each) for each in (other, small, large, *placed[:k]))
    within = [array for array in placed if np.shares_memory(array, memory._bytes[:room])]
    assert len(within) == min(3, room // 64)
    assert not any(np.shares_memory(array, memory._bytes[room:]) for array in placed)
