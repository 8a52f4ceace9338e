"""LBL and USBL: truth, errors against theory, sound through layers, what hides a beacon, and the time at which an answer arrives."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest

from uwserver.environment.column import ThermoclineColumn, WaterColumn
from uwserver.environment.eigenray import eigenray
from uwserver.environment.water import Water
from uwserver.frames import conjugate, quat_from_rpy, rotate
from uwserver.modifiers import Measurement
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import LblConfig, Pose, UsblConfig
from uwserver.sensors.acoustic.interrogation import Beacon
from uwserver.sensors.truth import Truth
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane, Sphere
from uwserver.units import rad
from uwserver.world import snapshot

PLACES = {"a": (120.0, 40.0, 60.0), "b": (-80.0, 150.0, 55.0), "c": (30.0, -200.0, 58.0)}
BEACONS = {name: Beacon(position_ned_m=p, turn_around_s=0.1) for name, p in PLACES.items()}
LBL, USBL = (kind(rate_hz=10, ideal=True, beacons=BEACONS) for kind in (LblConfig, UsblConfig))
CUBE = (
    (0.015, 0.0, 0.0),
    (-0.015, 0.0, 0.0),
    (0.0, 0.015, 0.0),
    (0.0, -0.015, 0.0),
    (0.0, 0.0, 0.015),
    (0.0, 0.0, -0.015),
)
NAME, RANGE = 0, 1
BEARING, ELEVATION, P_S, TIME, EACH = range(2, 7)


@dataclass
class Carrier:
    """A vehicle that carries a beacon."""

    p_NB: tuple[float, float, float]
    q_NB: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    nu: tuple[float, ...] = (0.0,) * 6


def exchange(device, instant):
    """Validity and values of an exchange in a world that stands still, but for beacons that drift."""
    device.memory.ready = 0.0
    return device.measure(instant)


def answers(config, instant, n, seed=0):
    """Those of n exchanges, one after the other."""
    device = config.build(Pose())
    device.start(np.random.default_rng(seed))
    return [Measurement(*exchange(device, instant)[::-1]) for _ in range(n)]


def test_contract(scope):
    state = {"t_ns": 10**9, "v_NB_B": (1.0, 0.0, 0.0)}
    instants = [
        scope(p_NB=p, q_NB=quat_from_rpy(0.1, -0.2, yaw), **state)
        for p in ((1, 2, 5.0), (0, 0, -3.0), (1e6, 0, 9e3))
        for yaw in (0, 3)
    ]
    for config in (
        LBL,
        USBL,
        LblConfig(rate_hz=10, beacons=BEACONS),
        UsblConfig(rate_hz=10, beacons=BEACONS, hydrophones_m=CUBE),
    ):
        check_sensor(config, instants=instants)


# -- truth ------------------------------------------------------------------------------------------------------------------------------

MOUNT = Pose((0.5, -0.3, -0.2), quat_from_rpy(0.1, 0.2, -0.7))
TILTED = {"p_NB": (3.0, -4.0, 6.0), "q_NB": quat_from_rpy(0.2, -0.1, 2.0)}


def test_ideal_lbl_is_the_truth_in_turn(scope):
    instant = scope(**TILTED)
    device = LBL.build(MOUNT)
    for name in ("a", "b", "c", "a"):
        valid, values = exchange(device, instant)
        d = math.dist(PLACES[name], instant.position(MOUNT.p))
        assert valid
        assert values[NAME] == name
        assert values[RANGE] == pytest.approx(d, abs=1e-9)
        assert values[2] == pytest.approx(2.0 * d / instant.water.sound_speed(30.0), rel=1e-3)


def test_ideal_usbl_is_the_truth(scope):
    instant = scope(**TILTED)
    _, v = USBL.build(MOUNT).measure(instant)
    p = rotate(conjugate(instant.attitude(MOUNT.q)), np.subtract(PLACES["a"], instant.position(MOUNT.p)))
    assert v[RANGE] == pytest.approx(math.hypot(*p), abs=1e-9)
    assert v[P_S] == pytest.approx(p, abs=1e-9)
    assert v[BEARING] == pytest.approx(math.atan2(p[1], p[0]), abs=1e-9)
    assert v[ELEVATION] == pytest.approx(math.atan2(p[2], math.hypot(p[0], p[1])), abs=1e-9)
    for place, each in zip(USBL.hydrophones_m, v[EACH], strict=True):  # the paper's form
        assert each == pytest.approx(math.dist(p, place), abs=1e-9)


def test_beacons_move_with_vehicles_and_ships(scope):
    beacons = {
        "ship": Beacon(position_ned_m=(100.0, 0.0, 2.0), velocity_ned_mps=(0.0, 1.5, 0.0)),
        "rov": Beacon(vehicle="rov", position_frd_m=(1.0, 0.0, 0.0)),
        "lost": Beacon(vehicle="nobody"),
    }
    config = LblConfig(rate_hz=10, ideal=True, beacons=beacons)
    instant = scope(p_NB=(0.0, 0.0, 5.0), t_ns=20 * 10**9)
    instant.vehicles = {"rov": Carrier((40.0, 30.0, 5.0), quat_from_rpy(0.0, 0.0, math.pi / 2))}
    ship, rov, lost = answers(config, instant, 3)
    # The ship is heard, and answers, where it is when the question gets there.
    heard = 30.0 + 1.5 * 0.5 * ship.values[2]
    assert ship.values[RANGE] == pytest.approx(math.dist((100.0, heard, 2.0), (0.0, 0.0, 5.0)), abs=1e-6)
    assert rov.values[RANGE] == pytest.approx(math.dist((40.0, 31.0, 5.0), (0.0, 0.0, 5.0)), abs=1e-9)
    assert (lost.valid, lost.values) == (False, ["lost", None, None])


# -- sound ------------------------------------------------------------------------------------------------------------------------------


def layered(scope):
    column = ThermoclineColumn(surface_temperature_degc=18.0, deep_temperature_degc=6.0, depth_m=40.0, thickness_m=20.0)
    instant = scope(p_NB=(0.0, 0.0, 5.0))
    instant.water = Water(1025.0, 9.81, 18.0, 101325.0, (0.0, 0.0, 0.0), given=WaterColumn(column, 9.81, 1025.0))
    return instant


def test_travel_time_through_the_layers(scope):
    """That of the eigenray; the believed sound speed makes a range of it; straight lines take longer."""
    instant = layered(scope)
    beacon = {"a": Beacon(position_ned_m=(300.0, 400.0, 150.0))}
    bent, lines = (
        answers(LblConfig(rate_hz=10, ideal=True, beacons=beacon, propagation=p), instant, 1)[0]
        for p in ("layered", "straight")
    )
    column = instant.water.column
    assert bent.values[2] == pytest.approx(
        2.0 * eigenray(column.depth, column.sound_speed, 500.0, 5.0, 150.0).time, rel=1e-12
    )
    assert bent.values[2] < lines.values[2]
    noisy = LblConfig(rate_hz=10, beacons=beacon, assumed_sound_speed_mps=1500.0, source_level_db=250.0)
    reading = answers(noisy, instant, 1)[0]
    assert reading.values[RANGE] == pytest.approx(750.0 * bent.values[2], abs=1e-3)


def test_usbl_sees_the_beacon_where_its_sound_comes_from(scope):
    instant = layered(scope)
    beacon = {"a": Beacon(position_ned_m=(300.0, 400.0, 150.0))}
    config = UsblConfig(rate_hz=10, beacons=beacon, hydrophones_m=CUBE, source_level_db=260.0)
    column = instant.water.column
    dip = eigenray(column.depth, column.sound_speed, 500.0, 5.0, 150.0).dip_a
    elevation = answers(config, instant, 1)[0].values[ELEVATION]
    assert elevation == pytest.approx(dip, abs=1e-4)
    assert abs(dip - math.atan2(145.0, 500.0)) > 0.005


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_range_jitter_follows_the_signal(scope, seed):
    """1 / (B sqrt snr) for each way."""
    config = LblConfig(rate_hz=10, beacons={"a": BEACONS["a"]}, max_range_m=5000.0)
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    r = np.array([reading.values[RANGE] for reading in answers(config, instant, 3000, seed)])
    c, alpha, d = (
        instant.water.sound_speed(20.0),
        instant.water.absorption(26e3, 20.0),
        math.dist(PLACES["a"], (0, 0, 20.0)),
    )
    snr = 10.0 ** (0.1 * (185.0 - 20.0 * math.log10(d) - alpha * d - 50.0 - 10.0 * math.log10(4e3)))
    assert r.std() == pytest.approx(c / (math.sqrt(2.0) * 4e3 * math.sqrt(snr)), rel=0.04)
    assert r.mean() == pytest.approx(d, abs=0.03)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("off_axis", [0.0, 30.0, 60.0])
def test_bearing_error_of_theory(scope, off_axis, seed):
    """sigma = c sigma_phi / (2 pi f d cos theta) along the line of two hydrophones d apart, sigma_phi = 1 / sqrt snr."""
    place = (200.0 * math.sin(rad(off_axis)), 0.0, 5.0 + 200.0 * math.cos(rad(off_axis)))
    config = UsblConfig(rate_hz=10, beacons={"a": Beacon(position_ned_m=place)}, propagation="straight")
    instant = scope(p_NB=(0.0, 0.0, 5.0))
    readings = answers(config, instant, 3000, seed)
    along = np.array([math.atan2(v.values[P_S][0], v.values[P_S][2]) for v in readings])
    c, alpha = instant.water.sound_speed(5.0), instant.water.absorption(26e3, 5.0)
    snr = 10.0 ** (0.1 * (185.0 - 20.0 * math.log10(200.0) - alpha * 200.0 - 50.0 - 10.0 * math.log10(4e3)))
    theory = c / math.sqrt(snr) / (2.0 * math.pi * 26e3 * 0.03 * math.cos(rad(off_axis)))
    assert along.std() == pytest.approx(theory, rel=0.05)
    assert along.mean() == pytest.approx(rad(off_axis), abs=5.0 * theory / math.sqrt(3000) + 1e-4)


def test_a_misaligned_array_turns_the_bearing(scope):
    config = UsblConfig(
        rate_hz=10, beacons={"a": BEACONS["a"]}, source_level_db=260.0, misalignment_rpy_deg=(0.0, 0.0, 2.0)
    )
    bearing = answers(config, scope(p_NB=(0.0, 0.0, 5.0)), 1)[0].values[BEARING]
    assert bearing == pytest.approx(math.atan2(40.0, 120.0) - rad(2.0), abs=2e-3)


def test_multipath_is_late_never_early(scope):
    config = LblConfig(rate_hz=10, beacons={"a": BEACONS["a"]}, multipath_probability=0.2, source_level_db=230.0)
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    error = np.array([r.values[RANGE] for r in answers(config, instant, 3000)]) - math.dist(PLACES["a"], (0, 0, 20.0))
    image = math.hypot(120.0, 40.0, 80.0) - math.hypot(120.0, 40.0, 40.0)
    late = error > 1.0
    assert late.mean() == pytest.approx(0.2, abs=0.025)
    assert error[late] == pytest.approx(np.full(late.sum(), image), abs=0.1)
    assert np.abs(error[~late]).max() < 0.1


# -- lost -------------------------------------------------------------------------------------------------------------------------------


def test_what_stands_between_hides_a_beacon(scope):
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    middle = tuple(0.5 * (a + b) for a, b in zip(PLACES["a"], (0.0, 0.0, 20.0), strict=True))
    aside = (middle[0], middle[1], middle[2] - 9.0)
    bottom = Plane((0.0, 0.0, 60.2), (0.0, 0.0, -1.0))
    for shape, seen in ((Sphere(middle, 2.0), False), (Sphere(aside, 2.0), True), (bottom, True)):
        instant.geometry = FakeGeometry([shape])
        assert answers(LBL, instant, 1)[0].valid is seen
    # The hull that carries the beacon does not hide it.
    instant.geometry = FakeGeometry([Sphere(PLACES["a"], 0.4)])
    assert answers(LBL, instant, 1)[0].valid


def test_lost_when_too_far_too_weak_or_out_of_the_water(scope):
    deep = scope(p_NB=(0.0, 0.0, 20.0))
    assert not answers(LblConfig(rate_hz=10, ideal=True, beacons=BEACONS, max_range_m=100.0), deep, 1)[0].valid
    assert not answers(LblConfig(rate_hz=10, beacons=BEACONS, source_level_db=130.0), deep, 1)[0].valid
    assert not answers(LBL, scope(p_NB=(0.0, 0.0, -1.0)), 1)[0].valid
    floating = LblConfig(rate_hz=10, ideal=True, beacons={"a": Beacon(position_ned_m=(10.0, 0.0, -1.0))})
    assert not answers(floating, deep, 1)[0].valid


def test_fading_loses_half_at_the_threshold(scope):
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    d, alpha = math.dist(PLACES["a"], (0, 0, 20.0)), instant.water.absorption(26e3, 20.0)
    at_threshold = 10.0 + 20.0 * math.log10(d) + alpha * d + 50.0 + 10.0 * math.log10(4e3)
    config = LblConfig(rate_hz=10, beacons={"a": BEACONS["a"]}, source_level_db=at_threshold, fading_sigma_db=3.0)
    assert np.mean([r.valid for r in answers(config, instant, 2000)]) == pytest.approx(0.5, abs=0.04)


# -- motion -----------------------------------------------------------------------------------------------------------------------------


def moving(scope, p, v, w=(0.0, 0.0, 0.0), rate_hz=240):
    """Instants at the ticks of a vehicle that starts level at p with constant v (N) and turns about its z."""
    for k in range(10_000):
        t = k / rate_hz
        q = quat_from_rpy(0.0, 0.0, w[2] * t)
        at = tuple(a + b * t for a, b in zip(p, v, strict=True))
        yield scope(p_NB=at, q_NB=q, v_NB_B=rotate(conjugate(q), v), w_NB_B=w, t_ns=round(t * 1e9))


def first(device, instants):
    return next(reading for reading in map(device.sense, instants) if reading is not None)


@pytest.mark.parametrize("speed", [-3.0, 0.0, 3.0])
@pytest.mark.parametrize("turn_around", [0.0, 0.3])
def test_a_moving_vehicle_hears_the_answer_where_it_is_by_then(scope, speed, turn_around):
    """Towards a beacon at distance d: there in d / c, and back in (d - v (d / c + turn-around)) / (c + v)."""
    d = 700.0
    beacon = Beacon(position_ned_m=(d, 0.0, 20.0), turn_around_s=turn_around)
    config = LblConfig(rate_hz=10, beacons={"a": beacon}, ideal=True, propagation="straight")
    reading = first(config.build(Pose()), moving(scope, (0.0, 0.0, 20.0), (speed, 0.0, 0.0)))
    c = scope().water.sound_speed(20.0)
    back = (d - speed * (d / c + turn_around)) / (c + speed)
    assert reading.values[2] == pytest.approx(d / c + back, abs=1e-11)
    assert reading.values[RANGE] == pytest.approx(0.5 * c * (d / c + back), abs=1e-8)
    assert reading.delay_ns == pytest.approx(1e9 * (d / c + turn_around + back), abs=1)
    assert reading.since_ns - 1e9 / 240 < reading.delay_ns <= reading.since_ns


def test_a_moving_beacon_is_asked_where_it_is_by_then(scope):
    """Across: c^2 t^2 = d^2 + v^2 t^2 there, and back from where it is after its turn-around."""
    d, v, turn_around = 600.0, 5.0, 0.25
    c = scope().water.sound_speed(20.0)
    there = d / math.sqrt(c * c - v * v)
    back = math.hypot(d, v * (there + turn_around)) / c
    device = LblConfig(
        rate_hz=10, beacons={"a": Beacon(vehicle="rov", turn_around_s=turn_around)}, ideal=True, propagation="straight"
    ).build(Pose())

    def instants():
        for k, instant in enumerate(moving(scope, (0.0, 0.0, 20.0), (0.0, 0.0, 0.0))):
            instant.vehicles = {"rov": Carrier((d, v * k / 240, 20.0), nu=(0.0, v, 0.0, 0.0, 0.0, 0.0))}
            yield instant

    assert first(device, instants()).values[2] == pytest.approx(there + back, abs=1e-11)


def test_usbl_takes_the_direction_when_the_answer_arrives(scope):
    """A vehicle that turns sees the beacon where it is at the arrival, not a tick later."""
    w, d = 0.7, 400.0
    config = UsblConfig(rate_hz=10, beacons={"a": Beacon(position_ned_m=(d, 0.0, 20.0))}, ideal=True)
    reading = first(config.build(Pose()), moving(scope, (0.0, 0.0, 20.0), (0.0, 0.0, 0.0), (0.0, 0.0, w)))
    assert reading.values[BEARING] == pytest.approx(-w * reading.values[TIME], abs=1e-9)


def test_in_a_world_the_range_is_that_of_the_way_it_went():
    """A vehicle that coasts: the range follows from the ground truth at the question and at the arrival."""
    lbl = LblConfig(
        rate_hz=10, ideal=True, propagation="straight", beacons={"a": Beacon(position_ned_m=(900.0, 0.0, 30.0))}
    )
    entry = VehicleEntry(
        model="bluerov2", position_ned_m=(0.0, 0.0, 30.0), velocity_frd_mps=(1.5, 0.3, 0.0), sensors={"lbl": lbl},
        truth=Truth(rate_hz=240),
    )  # fmt: skip
    world = build(load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}))
    samples = world.step(960)
    truth = {s.t_ns: s.value[0] for s in samples if s.port == "rov/truth/pose"}
    times = np.array([*truth])
    found = [s for s in samples if s.port == "rov/lbl"]
    assert len(found) >= 2
    for s in found:
        asked, heard = truth[s.t_ns], [np.interp(s.t_sent_ns, times, [p[k] for p in truth.values()]) for k in range(3)]
        expected = 0.5 * (math.dist(asked, (900.0, 0.0, 30.0)) + math.dist(heard, (900.0, 0.0, 30.0)))
        assert math.dist(asked, heard) > 0.2
        assert s.value[RANGE] == pytest.approx(expected, abs=1e-5)


def test_a_snapshot_amid_an_exchange_goes_on_alike():
    lbl = LblConfig(rate_hz=10, beacons={"a": Beacon(position_ned_m=(900.0, 0.0, 30.0))})
    entry = VehicleEntry(model="bluerov2", position_ned_m=(0.0, 0.0, 30.0), sensors={"lbl": lbl})
    world = build(load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}))
    world.step(300)
    kept = snapshot.take(world)
    once = [s.value for s in world.step(480) if s.port == "rov/lbl"]
    snapshot.restore(world, kept)
    assert [s.value for s in world.step(480) if s.port == "rov/lbl"] == once
    assert once


def test_sound_that_came_while_the_device_was_silent_is_missed(scope):
    device = LblConfig(rate_hz=10, beacons={"a": BEACONS["a"]}, ideal=True).build(Pose())
    ticks = list(itertools.islice(moving(scope, (0.0, 0.0, 5.0), (0.0, 0.0, 0.0)), 1200))
    reading = first(device, [*ticks[:2], *ticks[-2:]])
    assert not reading.valid


# -- time -------------------------------------------------------------------------------------------------------------------------------


def test_delivered_when_the_sound_arrives(scope):
    """There, turn-around, and back; the next question waits for it; without answer for as long as one could come."""
    device = LblConfig(rate_hz=240, ideal=True, beacons=BEACONS, max_range_m=200.0, processing_s=0.05).build(Pose())
    told = {}
    for k in range(480):
        reading = device.sense(scope(p_NB=(0.0, 0.0, 5.0), t_ns=round(k * 1e9 / 240)))
        if reading is not None:
            told[k - round(reading.since_ns * 240e-9)] = reading
            # Told at the first tick after the arrival, to be delivered after the processing.
            if reading.valid:
                assert reading.since_ns - 1e9 / 240 < reading.delay_ns - 0.05e9 <= reading.since_ns
    (k0, first), (k1, second), (k2, third), *_ = told.items()
    assert first.delay_ns == pytest.approx(1e9 * (first.values[2] + 0.1 + 0.05), abs=2)
    c = scope().water.sound_speed(5.0)
    assert not third.valid
    assert third.delay_ns == pytest.approx(1e9 * (400.0 / c + 0.1 + 0.05), abs=2)
    for early, late, reading in ((k0, k1, first), (k1, k2, second)):
        assert late - early == math.ceil(reading.delay_ns / 1e9 * 240)


def test_in_a_world_a_sample_arrives_later_than_it_was_true():
    """A ship tracks a vehicle by USBL: path, loader and delivery."""
    ship = UsblConfig(rate_hz=4, ideal=True, beacons={"rov": Beacon(vehicle="rov")})
    entries = {
        "ship": VehicleEntry(model="bluerov2", position_ned_m=(0.0, 0.0, 2.0), sensors={"usbl": ship}),
        "rov": VehicleEntry(model="bluerov2", position_ned_m=(300.0, 400.0, 52.0)),
    }
    world = build(load(Scenario(schema=1, vehicles=entries), adapters={}))
    samples = [s for s in world.step(480) if s.port == "ship/usbl"]
    assert len(samples) >= 2
    for sample in samples:
        travel = (sample.t_sent_ns - sample.t_ns) / 1e9
        assert travel == pytest.approx(2 * 502.5 / 1490.0, rel=0.02)
        assert sample.value[RANGE] == pytest.approx(502.5, abs=2.0)


def test_faults_of_beacons():
    with pytest.raises(ValueError, match="exactly one of"):
        Beacon()
    with pytest.raises(ValueError, match="on one line"):
        UsblConfig(rate_hz=1, beacons=BEACONS, hydrophones_m=((0, 0, 0), (1, 0, 0), (2, 0, 0)))
    sensor = LblConfig(rate_hz=1, beacons={"x": Beacon(vehicle="rvo")})
    with pytest.raises(ScenarioError, match=r'no vehicle "rvo" \(did you mean "rov"\?\)'):
        load(Scenario(schema=1, vehicles={"rov": VehicleEntry(model="bluerov2", sensors={"lbl": sensor})}), adapters={})


def test_settings(scope):
    device = LblConfig(rate_hz=10, beacons=BEACONS).build(Pose())
    instant = scope(p_NB=(0.0, 0.0, 20.0))
    assert exchange(device, instant)[0]
    device.change({"gain": -60.0})
    assert not exchange(device, instant)[0]
    assert device.properties() == {"max_range": 1000.0, "gain": -60.0, "sound_speed": 0.0}
