"""Copies of worlds with a bottom, things to touch, and sensors that need Python: each is what `uwserver.load` gives, bit by bit."""

import numpy as np
import pytest
from copies_rig import check_equal

import uwserver
from uwserver.physics.collision.engine import missing_engine
from uwserver.ports import Refused
from uwserver.scenario.builder import ScenarioBuilder

pytestmark = pytest.mark.skipif(missing_engine() is not None, reason="no engine for contacts is installed")
N = 3


def begun(name):
    b = ScenarioBuilder(name, seed=5, rate_hz=240).vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3])
    return b.truth("rov", rate_hz=40)


def pushing():
    """A wall, a crate that is pushed against it and rests on the bottom, and a contact sensor."""
    b = (
        begun("pushing")
        .seabed("flat", depth_m=3.4)
        .structure("wall", "box", size_m=[0.4, 3, 2], position_ned_m=[2.0, 0, 2.6])
    )
    b.free_object("crate", "box", size_m=[0.3, 0.5, 0.6], mass_kg=95, position_ned_m=[0.7, 0, 3.1])
    return b.sensor("rov", "bump", "contact", rate_hz=60).build()


def sounding():
    """Rays at a bottom and at another vehicle: a DVL with lock, an altimeter, a current profiler, a sonar that scans, and an array of rays."""
    b = begun("sounding").seabed("flat", depth_m=12).vehicle("other", "bluerov2_heavy", position_ned_m=[3, 0, 5])
    b.sensor("rov", "dvl", "dvl", rate_hz=8, profile="a50")
    b.sensor("rov", "sonar", "altimeter", rate_hz=5, profile="ping1d")
    b.sensor("rov", "rays", "range_array", rate_hz=4)
    b.sensor(
        "rov", "currents", "adcp", rate_hz=4, profile="signature1000", cells=10, cell_size_m=0.5, heading_sigma_deg=1
    )
    # Two that hear each other.
    b.sensor("rov", "scan", "scanning_sonar", rate_hz=10, profile="ping360", cross_talk_db=-40)
    b.sensor("rov", "pencil", "profiler", rate_hz=20, frequency_hz=7e5, cross_talk_db=-40, rpy_deg=[0, -90, 0])
    return b.build()


def wet():
    """Water, shafts, and a beacon on whose answer one waits: a sensor in Python."""
    b = begun("wet").seabed("flat", depth_m=12)
    b.sensor("rov", "ctd", "ctd", rate_hz=4)
    b.sensor("rov", "rpm", "rpm", rate_hz=10, members=["t1", "t5"])
    b.sensor("rov", "fix", "usbl", rate_hz=1, beacons={"b": {"position_ned_m": [30, 5, 12]}})
    return b.modifier("rov", "ctd", "worn", "white_noise", field="temperature", sigma=0.1).build()


def worlds_of(scenario):
    return [uwserver.load(scenario, seed=5 + i).core for i in range(N)]


def check_all(batch, worlds):
    """Each copy and its world."""
    for k, world in enumerate(worlds):
        check_equal(batch, k, world)


def drive(batch, worlds, u, ticks):
    """The same command, and so many ticks: in one call, and in as many."""
    batch.command("rov/thrusters", u=np.array(u))
    batch.step(ticks)
    for world in worlds:
        world.command("rov/thrusters", u=u)
        world.step(ticks)


AHEAD, UP = [-0.6, -0.6, 0.6, 0.6, 0, 0, 0, 0], [0, 0, 0, 0, -0.8, -0.8, -0.8, -0.8]


@pytest.mark.parametrize("scenario", [pushing, sounding, wet])
@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_each_copy_is_what_load_gives(scenario, threads):
    batch, worlds = uwserver.batch(scenario(), N, threads=threads), worlds_of(scenario())
    for turn in range(6):
        drive(batch, worlds, AHEAD if turn % 3 else UP, 100)
        check_all(batch, worlds)
    for port in batch.ports:
        assert (batch.read(port).seq >= 0).all(), port
    batch.close()


@pytest.mark.parametrize("scenario", [pushing, sounding, wet])
def test_a_reset_copy_begins_anew_and_the_others_go_on(scenario):
    """Contacts, and what sensors in Python remember, are forgotten."""
    batch, worlds = uwserver.batch(scenario(), N), worlds_of(scenario())
    drive(batch, worlds, AHEAD, 330)
    batch.reset([1])
    worlds[1] = worlds_of(scenario())[1]
    check_all(batch, worlds)
    for _ in range(3):
        drive(batch, worlds, AHEAD, 110)
        check_all(batch, worlds)


def test_what_is_pushed_pushes_back():
    """The vehicle reaches the crate, and the crate the wall."""
    batch = uwserver.batch(pushing(), N)
    batch.command("rov/thrusters", u=np.array(AHEAD))
    felt = np.zeros(N, bool)
    for _ in range(40):
        batch.step(24)
        felt |= batch.read("rov/bump")["touching"]
    crate = batch.states("crate")
    assert (crate[:, 0] > 0.8).all()
    assert (crate[:, 0] < 1.66).all(), "not into the wall"
    assert (crate[:, 2] < 3.11).all(), "not into the bottom"
    assert felt.all()


def test_all_copies_hear_the_bottom():
    batch = uwserver.batch(sounding(), N)
    batch.step(480)
    assert batch.read("rov/dvl").valid.all()
    ranges = batch.read("rov/sonar")["range"]
    assert np.allclose(ranges, 12 - 3, atol=0.5)


def test_a_factor_of_errors_is_refused_where_it_scales_none():
    """Sensors in Python draw their own; a latency they all have."""
    with pytest.raises(Refused, match="cannot be scaled: rov/fix;"):
        uwserver.batch(wet(), N, noise=0.5)
    batch = uwserver.batch(wet(), N, latency=[0.0, 0.5, 0.0])
    batch.step(240)
    sent = batch.read("rov/rpm")
    late = (sent.t_sent_ns - sent.t_ns).tolist()
    assert late[1] - late[0] == 500_000_000
    assert late[0] == late[2]


def test_what_draws_nothing_in_python_does_not_stand_against_a_factor():
    """A contact sensor has no errors, and messages of others have theirs."""
    assert uwserver.batch(pushing(), N, noise=0.5).n == N


def test_sensors_measure_that_others_need():
    b = begun("compound").sensor("rov", "ctd", "ctd", rate_hz=4)
    b.sensor("rov", "water", "compound", rate_hz=4, members=["ctd"])
    batch = uwserver.batch(b.build(), N, sensors=["rov/water"])
    batch.step(240)
    assert (batch.read("rov/water").seq >= 0).all()
    assert set(batch.ports) == {"rov/water", "rov/ctd"}


def test_a_call_that_is_broken_off_leaves_copies_that_can_go_on(monkeypatch):
    """By Ctrl-C: all stand between two ticks, and are stepped again."""
    batch = uwserver.batch(wet(), N)
    stepping, left = batch._copies[1].world.stepping, [3]
    answer = stepping.answer

    def interrupted(why):
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt
        answer(why)

    monkeypatch.setattr(stepping, "answer", interrupted)
    with pytest.raises(KeyboardInterrupt):
        batch.step(600)
    before = batch.ticks
    batch.step(240)
    assert (batch.ticks - before).tolist() == [240] * N
    assert not batch.diverged.any()
    batch.reset()
    worlds = worlds_of(wet())
    drive(batch, worlds, AHEAD, 300)
    check_all(batch, worlds)


def test_what_copies_only_read_of_solid_things_is_there_once():
    """Else a thousand copies of a seabed would need gigabytes; and none has an engine of its own."""
    batch = uwserver.batch("slope", N)
    scenes = [copy.world.scene for copy in batch._copies]
    assert len({id(scene.stocks) for scene in scenes}) == 1
    finding = [scene.finding() for scene in scenes]
    triangles = [int(each.table[k, 0]) for each in finding for k in range(len(each.table)) if each.table[k, 1] > 1000]
    assert triangles
    assert len(set(triangles)) < len(triangles) / 2


def measured():
    """What four kinds of sensors tell without Python: water, shafts, a bumper, rays."""
    b = begun("measured").seabed("flat", depth_m=12).vehicle("other", "bluerov2_heavy", position_ned_m=[3, 0, 5])
    b.sensor("rov", "ctd", "ctd", rate_hz=240, temperature_sigma_degc=0.01)
    b.sensor("other", "rays", "range_array", rate_hz=240, rpy_deg=[0, -90, 0], sigma_m=0.02)
    b.sensor("rov", "bump", "contact", rate_hz=240)
    for name in ("rov", "other"):
        b.sensor(name, "shafts", "rpm", rate_hz=240, members=["t2", "t1"], sigma_radps=0.1)
    return b.build()


def test_four_kinds_need_no_python():
    """And each vehicle tells of its own shafts."""
    world = uwserver.load(measured()).core
    world.command("other/thrusters", u=[0.5, -0.7, 0, 0, 0, 0, 0, 0])
    samples = {sample.port: sample for sample in world.step(240)}
    assert {why for why, count in world.stops.items() if count} <= {"room"}
    assert all(samples[f"{name}/shafts"].valid for name in ("rov", "other"))
    rest, turning = (samples[f"{name}/shafts"].value[0] for name in ("rov", "other"))
    assert np.allclose(rest, 0.0, atol=0.6)
    assert turning[0] < -50.0
    assert turning[1] > 50.0


def test_a_factor_scales_their_errors():
    factors = [0.0, 1.0, 3.0]
    batch = uwserver.batch(measured(), N, seeds=[1] * N, noise=factors)
    batch.step(240)
    for port, field in (("rov/ctd", "temperature"), ("other/shafts", "speeds"), ("other/rays", "ranges")):
        errors = np.asarray(batch.read(port)[field], float).reshape(N, -1)
        errors = errors - errors[0]
        assert (errors[1] != 0.0).all(), port
        assert np.allclose(errors[2], 3.0 * errors[1], rtol=1e-6, atol=1e-9), port


def test_a_factor_scales_the_noise_of_sonars():
    """Amplitudes of a sonar that hears nothing else."""
    b = begun("silence").sensor("rov", "scan", "scanning_sonar", rate_hz=10, output="pressure", bins=2000, range_m=2.0)
    batch = uwserver.batch(b.build(), N, noise=[1.0, 3.0, 0.0])
    batch.step(48)
    power = np.mean(batch.read("rov/scan")["bins"] ** 2, axis=1)
    assert power[1] / power[0] == pytest.approx(9.0, rel=0.1)
    assert power[2] == 0.0
