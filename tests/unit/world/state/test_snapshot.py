"""Snapshot, restore, reset and the state hash: bit for bit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from uwserver.ports import Command, Refused
from uwserver.world.state import snapshot


def drive(world, ticks, rng):
    """Random commands at random ticks; returns the samples."""
    samples = []
    for _ in range(ticks):
        if rng.random() < 0.1:
            world.command("rov/thrusters", u=rng.uniform(-1, 1, 8).tolist())
        samples += world.step()
    return samples


@pytest.mark.parametrize("seed", range(5))
def test_restore_at_random_ticks_continues_the_same_stream(world, seed):
    rng = np.random.default_rng(seed)
    drive(world, int(rng.integers(1, 300)), rng)
    saved = snapshot.take(world)
    first = drive(world, 200, np.random.default_rng(seed + 100))
    first_hash = snapshot.take(world).hash()
    drive(world, 37, rng)
    snapshot.restore(world, saved)
    assert snapshot.take(world) == saved
    assert drive(world, 200, np.random.default_rng(seed + 100)) == first
    assert snapshot.take(world).hash() == first_hash


def test_a_fresh_world_takes_over_a_snapshot(make_world):
    one, two = make_world(), make_world()
    drive(one, 123, np.random.default_rng(1))
    snapshot.restore(two, snapshot.take(one))
    assert drive(one, 100, np.random.default_rng(2)) == drive(two, 100, np.random.default_rng(2))


def test_reset_leaks_nothing(world):
    first = drive(world, 300, np.random.default_rng(3))
    end = world.call("world/state_hash")
    world.call("world/set_current", velocity_N=[0.1, 0.2, 0.0])
    world.call("rov/imu/set", rate_hz=60)
    drive(world, 50, np.random.default_rng(4))
    world.call("world/reset")
    assert world.tick == 0
    assert drive(world, 300, np.random.default_rng(3)) == first
    assert world.call("world/state_hash") == end


def test_the_hash_sees_every_part_of_the_state(make_world):
    def changed(change):
        world = make_world()
        world.step(20)
        change(world)
        return snapshot.take(world).hash()

    def nothing(world):
        pass

    def bump_state(world):
        world.hydro.state[0, 3] = np.nextafter(world.hydro.state[0, 3], 2)

    def bump_lag(world):
        world.hydro.thrusters["x"][0, 1] += 1e-300

    def remember(world):
        """The last number of all that a sensor and its errors remember."""
        slot = world.sensors["rov/pressure"]
        state = slot.save()
        slot.load(
            structs.replace(state, numbers=state.numbers[:-8] + bytes([state.numbers[-8] ^ 1]) + state.numbers[-7:])
        )

    def count(world):
        """Random numbers go with it."""
        slot = world.sensors["rov/depth"]
        slot.load(structs.replace(slot.save(), number=slot.number + 1))

    def current(world):
        world.set_current((0.0, 0.0, 1e-9))

    hashes = [changed(change) for change in (nothing, bump_state, bump_lag, remember, count, current)]
    assert len(set(hashes)) == len(hashes)
    assert changed(nothing) == hashes[0]


@pytest.mark.slow
def test_equal_runs_hash_equally_in_another_process(make_world):
    script = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import numpy as np\n"
        "from conftest import small_scenario\n"
        "from uwserver.scenario.build.world import build\n"
        "from uwserver.world import snapshot\n"
        "w = build(small_scenario())\n"
        "w.command('rov/thrusters', u=[0.3] * 8)\n"
        "w.step(500)\n"
        "print(snapshot.take(w).hash())\n"
    )
    tests = str(Path(__file__).parents[3])
    other = subprocess.run(
        [sys.executable, "-c", script, tests], capture_output=True, text=True, timeout=120, check=True
    )
    world = make_world()
    world.command("rov/thrusters", u=[0.3] * 8)
    world.step(500)
    assert other.stdout.strip() == snapshot.take(world).hash()


def test_a_snapshot_of_another_world_is_refused(make_world):
    with pytest.raises(Refused, match="other vehicles"):
        snapshot.restore(make_world(vehicles=2), snapshot.take(make_world()))


def test_named_snapshots_by_service(world):
    world.step(10)
    kept = world.call("world/snapshot", name="a")
    world.step(30)
    assert world.call("world/restore", name="a") == {"tick": 10, "t_ns": world.t_ns}
    assert world.call("world/state_hash")["hash"] == kept["hash"]
    with pytest.raises(Refused, match="there are: a"):
        world.call("world/restore", name="b")
    for k in range(31):
        world.call("world/snapshot", name=str(k))
    with pytest.raises(Refused, match="32 snapshots"):
        world.call("world/snapshot", name="one too many")


def test_what_was_read_before_a_reset_is_forgotten(world):
    world.step(240)
    assert world.read("rov/imu") is not None
    world.call("world/reset")
    assert world.read("rov/imu") is None


def test_the_hash_does_not_tell_who_commanded(make_world):
    hashes = set()
    for source in ("sockets:1", "sockets:2 (me)"):
        world = make_world()
        world.submit(Command("rov/thrusters", ((0.1,) * 8,), source))
        world.step(5)
        hashes.add(snapshot.take(world).hash())
    assert len(hashes) == 1
