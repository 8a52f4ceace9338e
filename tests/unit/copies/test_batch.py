"""Copies of a world: each is bit by bit what `uwserver.load` gives, whatever the others do.

Also of uwserver.copies.readings, uwserver.copies.readings, uwserver.copies.start and uwserver.step.many.
"""

import numpy as np
import pytest

import uwserver
from uwserver.copies.copy import Copy
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.places import FUTEX
from uwserver.ports import Refused
from uwserver.scenario.builder import ScenarioBuilder


def stormy():
    """Waves, a drifting current, noise, delays, a watchdog, a battery and a fault."""
    b = ScenarioBuilder("stormy", seed=5, rate_hz=240)
    b.environment(density_kgpm3=1025).current(velocity_ned_mps=[0.2, -0.1, 0.0])
    b.add_current("gusts", "gauss_markov", sigma_ned_mps=[0.1, 0.1, 0.02], tau_s=2.0)
    b.waves(significant_height_m=0.5, peak_period_s=5, direction_deg=30, components=8)
    b.vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3])
    b.truth("rov", rate_hz=10)
    b.sensor("rov", "imu", "imu", rate_hz=60, profile="mems_imu")
    b.sensor("rov", "ahrs", "attitude", rate_hz=40, profile="mems_ahrs", latency_s=0.02)
    b.sensor("rov", "dvl", "dvl", rate_hz=8, profile="a50")
    b.sensor("rov", "sonar", "altimeter", rate_hz=5, profile="ping1d")
    b.sensor("rov", "currents", "adcp", rate_hz=2, profile="workhorse600", cells=4, cell_size_m=1)
    b.sensor("rov", "cell", "battery", rate_hz=2, profile="lipo_4s_18ah")
    b.modifier("rov", "ahrs", "wander", "gauss_markov", field="heading", sigma=0.01, tau_s=3)
    b.modifier("rov", "ahrs", "late", "delay", latency_s=0.05, jitter_s=0.03)
    b.modifier("rov", "imu", "lost", "dropout", probability=0.1)
    b.fault("weak", "thruster_weak", "rov/thrusters", members=["t1"], factor=0.4, at_s=1.0, until_s=4.0)
    return b.build()


def piloted():
    """An autopilot that holds its depth against a current, on noisy sensors."""
    b = ScenarioBuilder("piloted", seed=3, rate_hz=240).current(velocity_ned_mps=[0.1, 0.0, 0.0])
    b.vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3], autopilot={"mode": "depth_hold", "armed": True})
    b.sensor("rov", "imu", "imu", rate_hz=60, profile="mems_imu")
    b.sensor("rov", "ahrs", "attitude", rate_hz=40, profile="mems_ahrs")
    b.sensor("rov", "pressure", "pressure", rate_hz=40, profile="bar30")
    return b.build()


def check_equal(batch, k, world):
    """Copy k and a world have the same state and the same newest samples, bit by bit."""
    for vehicle in batch.vehicles:
        assert np.array_equal(batch.states(vehicle)[k], world.hydro.state[world.vehicles[vehicle].row])
    for port in batch.ports:
        ours, theirs = batch.read(port), world.read(port)
        if theirs is None:
            assert ours.seq[k] == -1
            continue
        stamps = (ours.seq[k], ours.t_ns[k], ours.t_sent_ns[k], ours.valid[k])
        assert stamps == (theirs.seq, theirs.t_ns, theirs.t_sent_ns, theirs.valid), port
        for field in ours:
            assert np.array_equal(ours[field][k], np.array(theirs.array(field), ours[field].dtype), equal_nan=True), (
                port
            )


def fly(batch, worlds, turns, ticks, rng):
    """Random commands, and now and then none for longer than the watchdog waits; `worlds` are those of the first copies."""
    for turn in range(turns):
        if turn % 50 < 30:
            u = rng.uniform(-1.0, 1.0, (batch.n, 8))
            batch.command("rov/thrusters", u=u)
            for k, world in enumerate(worlds):
                world.command("rov/thrusters", u=u[k])
        batch.step(ticks)
        for k, world in enumerate(worlds):
            world.step(ticks)
            check_equal(batch, k, world)


@pytest.mark.parametrize("turns", [100, pytest.param(250, marks=pytest.mark.slow)])
def test_copies_are_what_load_gives_over_a_thousand_ticks(turns):
    """And over 3000, in waves and gusts, with errors, delays, watchdogs, a battery and a fault: the first copy, and the next with its own seed."""
    batch = uwserver.batch(stormy(), 3)
    worlds = [uwserver.load(stormy()).core, uwserver.load(stormy(), seed=6).core]
    fly(batch, worlds, turns, 12, np.random.default_rng(1))
    said = {event.event for k, event in batch.events() if k == 0}
    assert said == {"watchdog", "fault"}
    assert not np.array_equal(batch.states()[0], batch.states()[2])


def test_a_copy_that_is_reset_begins_anew_and_the_others_go_on():
    """Its clock, its waves, its random numbers are those of the start, though the others stand elsewhere in time."""
    batch, others = uwserver.batch(stormy(), 2), uwserver.load(stormy()).core
    fly(batch, [others], 13, 7, np.random.default_rng(2))
    batch.command("rov/thrusters", u=np.ones(8), copies=[1])
    batch.reset([1])
    fresh = uwserver.load(stormy(), seed=6).core
    assert batch.ticks.tolist() == [91, 0]
    fly(batch, [others, fresh], 40, 7, np.random.default_rng(3))
    batch.reset(np.array([True, False]), seeds=6)
    fly(batch, [uwserver.load(stormy(), seed=6).core, fresh], 20, 7, np.random.default_rng(4))


def test_autopilots_fly_the_copies_as_they_fly_a_world():
    """Set points as arrays, services copy by copy; what an armed autopilot holds nobody else commands."""
    batch, worlds = uwserver.batch(piloted(), 2), [uwserver.load(piloted()).core, uwserver.load(piloted(), seed=4).core]
    for turn in range(40):
        if turn == 5:  # sticks that spring back when nobody holds them any longer
            batch.command("rov/autopilot/pilot", u=[0.5, 0, 0, 0, 0, 0])
            for world in worlds:
                world.command("rov/autopilot/pilot", u=[0.5, 0, 0, 0, 0, 0])
        if turn == 20:
            batch.command("rov/autopilot/depth", depth=[4.0, 2.0])
            for world, depth in zip(worlds, (4.0, 2.0), strict=True):
                world.command("rov/autopilot/depth", depth=depth)
        if turn == 30:
            batch.call("rov/autopilot/set_mode", [1], mode="manual")
            worlds[1].call("rov/autopilot/set_mode", mode="manual")
        batch.step(20)
        for k, world in enumerate(worlds):
            world.step(20)
            check_equal(batch, k, world)
    assert batch.states()[0, 2] > batch.states()[1, 2] + 0.1
    with pytest.raises(Refused, match="of copy 0"):
        batch.command("rov/thrusters", u=np.zeros(8))
    batch.reset()
    worlds = [uwserver.load(piloted()).core]
    for _ in range(20):
        batch.step(20)
        worlds[0].step(20)
        check_equal(batch, 0, worlds[0])


def test_a_vehicle_with_fins_is_copied_too():
    scenario = ScenarioBuilder("fins", rate_hz=240).vehicle("auv", "remus100", position_ned_m=[0, 0, 5]).build()
    batch, world = uwserver.batch(scenario, 2), uwserver.load(scenario).core
    for port, each in batch.commands.items():
        if each.kind in ("fins", "fin", "propeller"):
            field = each.fields[0]
            value = np.full(field.shape, 0.5 * field.maximum)
            batch.command(port, **{field.name: value})
            world.command(port, **{field.name: value})
    batch.step(600)
    world.step(600)
    check_equal(batch, 0, world)
    assert np.array_equal(*batch.states())
    assert batch.states()[0, 7] > 0.1


def test_sensors_that_nobody_named_do_not_measure_and_change_nothing():
    all_of_them, some = uwserver.batch(stormy(), 2), uwserver.batch(stormy(), 2, sensors=["rov/imu"])
    assert sorted(some.ports) == ["rov/cell", "rov/imu"]  # a battery supplies the thrusters
    for batch in (all_of_them, some):
        batch.command("rov/thrusters", u=np.full(8, 0.5))
        batch.step(240)
    assert np.array_equal(all_of_them.states(), some.states())
    assert np.array_equal(all_of_them.read("rov/imu")["f_S"], some.read("rov/imu")["f_S"], equal_nan=True)
    with pytest.raises(Refused, match="no port"):
        some.read("rov/ahrs")
    with pytest.raises(Refused, match='"rov/gyro"'):
        uwserver.batch(stormy(), 2, sensors=["rov/gyro"])


def test_a_copy_that_diverges_is_a_mask_and_the_others_go_on():
    batch, world = uwserver.batch(stormy(), 3), uwserver.load(stormy()).core
    batch._copies[1].world.hydro.state[0, 7] = np.nan
    assert batch.step(50).tolist() == [False, True, False]
    world.step(50)
    check_equal(batch, 0, world)
    assert batch.ticks.tolist() == [50, 1, 50]
    batch.reset(batch.diverged)
    assert not batch.step(10).any()
    fresh = uwserver.load(stormy(), seed=6).core
    fresh.step(10)
    check_equal(batch, 1, fresh)


def test_nothing_that_is_returned_changes_later_unless_it_is_given_as_out():
    batch = uwserver.batch(stormy(), 2)
    batch.step(60)
    taken = {
        "states": batch.states(),
        "ticks": batch.ticks,
        "diverged": batch.diverged,
        "t_s": batch.t_s,
    } | batch.parameters
    readings = batch.read("rov/imu")
    taken |= {field: readings[field] for field in readings}
    before = {name: array.copy() for name, array in taken.items()}
    u = np.full((2, 8), 0.3)
    batch.command("rov/thrusters", u=u)
    u[:] = -1.0  # the batch has a copy
    batch.step(60)
    world = uwserver.load(stormy()).core
    world.step(60)
    world.command("rov/thrusters", u=[0.3] * 8)
    world.step(60)
    check_equal(batch, 0, world)
    for name, array in taken.items():
        assert np.array_equal(array, before[name], equal_nan=True), name
        array[...] = 0
    check_equal(batch, 0, world)
    out = np.empty((2, 13))
    assert batch.states(out=out) is out
    assert np.array_equal(out, batch.states())
    assert batch.read("rov/imu", out=readings) is readings
    assert readings.seq[0] == world.read("rov/imu").seq
    with pytest.raises(ValueError, match="out must be"):
        batch.states(out=np.empty((3, 13)))


def test_describe_tells_every_array_as_it_is():
    batch = uwserver.batch(stormy(), 2)
    batch.step(120)
    told = batch.describe()
    assert told["states"]["shape"] == list(batch.states().shape)
    assert told["sensors"].keys() == batch.ports.keys()
    for port, each in told["sensors"].items():
        readings = batch.read(port)
        assert {name: list(readings[name].shape) for name in readings} == {
            n: f["shape"] for n, f in each["fields"].items()
        }
    assert told["commands"]["rov/thrusters"]["fields"]["u"]["shape"] == [2, 8]
    assert {name: each["shape"] for name, each in told["parameters"].items()} == {
        name: list(values.shape) for name, values in batch.parameters.items()
    }


@pytest.mark.parametrize(
    ("copies", "text"), [([2], "0 to 1"), ([-1], "0 to 1"), ([0, 0], "once"), ([True], "mask of 2"), ([0.5], "numbers")]
)
def test_copies_that_are_not_there_are_refused(copies, text):
    with pytest.raises(Refused, match=text):
        uwserver.batch("bluerov2_pool", 2, sensors=()).reset(copies)


def test_less_than_a_tick_a_copy_or_a_seed_each_is_refused():
    batch = uwserver.batch("bluerov2_pool", 2, sensors=(), seeds=[7, 8])
    assert batch.seeds == [7, 8]
    with pytest.raises(Refused, match="1 or more, not 0"):
        batch.step(0)
    with pytest.raises(Refused, match="3 seeds for 2"):
        batch.reset(seeds=[1, 2, 3])
    with pytest.raises(Refused, match="copies, 1 or more, not 0"):
        uwserver.batch("bluerov2_pool", 0)
    with pytest.raises(Refused, match="1 seeds for 2"):
        uwserver.batch("bluerov2_pool", 2, seeds=[1])


@pytest.mark.skipif(not FUTEX, reason="threads of a world wait in compiled code on Linux alone")
def test_a_copy_of_many_bodies_has_no_threads_of_its_own():
    """A thousand copies would have a thousand."""
    b = ScenarioBuilder("crowd", rate_hz=240).world(threads=2)
    for k in range(16):
        b.vehicle(f"rov{k}", "bluerov2_heavy", position_ned_m=[3.0 * k, 0, 3])
    world = uwserver.load(b.build()).core
    assert world.threads.count == 2
    Copy(world, ())
    assert world.threads.count == 1
    batch, alone = uwserver.batch(b.build(), 2, threads=2), uwserver.load(b.build()).core
    batch.step(24)
    alone.step(24)
    assert batch.states("rov9")[0].tobytes() == alone.hydro.state[alone.vehicles["rov9"].row].tobytes()
    k = [*layout.WORLD].index("scratch")
    assert [int(copy.world.hydro.table[k, 1]) for copy in batch._copies] == [1, 1], "of the thread alone"
    batch.close()


@pytest.mark.parametrize(
    ("scenario", "turns"), [(stormy, 80), (piloted, 60), pytest.param(stormy, 200, marks=pytest.mark.slow)]
)
def test_threads_change_no_number(scenario, turns):
    """A thousand ticks, with resets on the way that set the copies apart in time."""
    ours, theirs = uwserver.batch(scenario(), 5, threads=2), uwserver.batch(scenario(), 5, threads=1)
    assert (ours.threads, theirs.threads, theirs.n) == (2, 1, 5)
    rng = np.random.default_rng(8)
    for turn in range(turns):
        u = rng.uniform(-1.0, 1.0, (5, 8))
        for batch in (ours, theirs):
            if scenario is stormy:
                batch.command("rov/thrusters", u=u)
            if turn == 30:
                batch.reset([1, 4])
            batch.step(13)
        assert np.array_equal(ours.states(), theirs.states())
        for port in ours.ports:
            one, other = ours.read(port), theirs.read(port)
            assert np.array_equal(one.stamps, other.stamps)
            assert np.array_equal(one.packed, other.packed, equal_nan=True)
    assert len(set(ours.ticks.tolist())) == 2
    ours.close()
    assert (ours.threads, ours.step().any()) == (1, False)


def test_copies_share_no_room_for_rays():
    """Else one thread would read what another aims."""
    batch = uwserver.batch(stormy(), 4, threads=2)
    rows = [copy.world.stepping.given.rows for copy in batch._copies]
    assert len(rows[0]["origin"])
    for name in ("origin", "direction", "first", "distance", "due", "turn"):
        assert len({row[name].ctypes.data for row in rows}) == 4, name
    batch.close()
