"""Navigation and water sensors: exact when ideal, and the statistics of their errors."""

from __future__ import annotations

import math
from dataclasses import replace

import gsw
import msgspec
import numpy as np
import pytest

from uwserver.environment.column import TableColumn, WaterColumn
from uwserver.environment.earth import Earth
from uwserver.environment.geodesy import latitude_longitude, north_east
from uwserver.environment.water import Water
from uwserver.frames import quat_from_rpy, rotate
from uwserver.scenario.build.world import stream_of
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.vehicle.profiles import check_profile
from uwserver.scenario.world.magnetic import magnetic_about
from uwserver.sensors import (
    AttitudeConfig,
    ClockConfig,
    CtdConfig,
    GpsConfig,
    ImuConfig,
    MagnetometerConfig,
    Pose,
    SoundSpeedConfig,
)
from uwserver.sensors.motion.triad import HUMP, Triad, TriadErrors
from uwserver.sensors.water.ctd import practical_salinity
from uwserver.units import deg, rad

EARTH = Earth(rad(63.43), rad(10.40), 1_767_225_600_000_000_000, magnetic_about(rad(63.43), rad(10.40), 2026.5))
MOUNT = Pose((0.3, -0.2, -0.1), quat_from_rpy(0.4, -0.3, 2.0))
Q = quat_from_rpy(0.1, -0.2, 1.3)
CAST = TableColumn(depth_m=(0.0, 10.0, 20.0), temperature_degc=(18.0, 18.0, 8.0), salinity_psu=(30.0, 30.0, 35.0))
SEA = Water(1023.0, 9.81, 18.0, 101_325.0, (0.0, 0.0, 0.0), given=WaterColumn(CAST, 9.81, 1023.0))


def started(config, seed=1, dt=None, mount=MOUNT):
    sensor = config.build(mount)
    sensor.dt = 1.0 / config.rate_hz if dt is None else dt
    sensor.start(stream_of(seed, "rov/x"))
    return sensor


def at(scope, t, **changes):
    return replace(scope(earth=EARTH, **changes), t_ns=round(t * 1e9))


# -- where ------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [(0.0, 0.0), (3000.0, -4000.0), (-250_000.0, 180_000.0)])
@pytest.mark.parametrize("origin", [(63.43, 10.40), (0.0, 179.9), (-45.0, -170.0)])
def test_geodesy_leads_there_and_back(place, origin):
    latitude, longitude = latitude_longitude(*place, rad(origin[0]), rad(origin[1]))
    north, east = north_east(np.array(latitude), np.array(longitude), rad(origin[0]), rad(origin[1]))
    assert (float(north), float(east)) == pytest.approx(place, abs=1e-6)


def test_the_magnetic_field_is_that_of_the_model():
    """D 5.257 deg and F 52 282.5 nT at 63.43 N 10.40 E in 2026.5; 5.31 deg by the IGRF."""
    at_origin = EARTH.magnetic[0]
    assert deg(EARTH.declination) == pytest.approx(5.257, abs=0.001)
    assert math.hypot(*at_origin) == pytest.approx(52_282.5e-9, abs=0.1e-9)
    there = magnetic_about(*latitude_longitude(8000.0, -6000.0, EARTH.latitude, EARTH.longitude), 2026.5)[0]
    assert EARTH.magnetic_field((8000.0, -6000.0, 0.0)) == pytest.approx(there, abs=60e-9)


# -- GPS --------------------------------------------------------------------------------------------------------------------------------


def test_ideal_gps_equals_the_truth(scope):
    instant = at(scope, 3.0, p_NB=(1200.0, -300.0, -0.5), q_NB=Q, v_NB_B=(1.0, 2.0, 3.0), w_NB_B=(0.1, 0.2, 0.3))
    reading = started(GpsConfig(rate_hz=5, ideal=True, horizontal_sigma_m=9.0, hot_fix_s=9.0, cold_fix_s=9.0)).sense(
        instant
    )
    x, y, z = instant.position(MOUNT.p)
    north, east = north_east(np.array(reading.values[0]), np.array(reading.values[1]), EARTH.latitude, EARTH.longitude)
    assert reading.valid
    assert (float(north), float(east), -reading.values[2]) == pytest.approx((x, y, z), abs=1e-6)
    cross = np.cross((0.1, 0.2, 0.3), MOUNT.p)
    assert reading.values[3] == pytest.approx(rotate(Q, tuple(np.add((1.0, 2.0, 3.0), cross))), abs=1e-9)
    assert reading.values[7:] == [12, 3]


def test_no_fix_under_water_and_none_for_a_while_after(scope):
    gps = started(GpsConfig(rate_hz=5, hot_fix_s=2.0, cold_fix_s=10.0, cold_after_s=100.0))
    up, down = {"p_NB": (0.0, 0.0, -1.0)}, {"p_NB": (0.0, 0.0, 2.0)}

    def fixes(start, end, where):
        times = np.arange(start, end, 0.2)
        return [t for t in times if gps.sense(at(scope, t, **where)).valid]

    assert min(fixes(0.0, 20.0, up)) == pytest.approx(10.0)  # cold start
    assert not fixes(20.0, 30.0, down)
    assert min(fixes(30.0, 40.0, up)) == pytest.approx(32.0)  # hot
    assert not fixes(40.0, 200.0, down)
    assert min(fixes(200.0, 220.0, up)) == pytest.approx(210.0)  # too long away
    reading = gps.sense(at(scope, 221.0, **down))
    assert reading.values == [None, None, None, (None,) * 3, None, None, None, 0, 0]


def test_a_wave_over_the_antenna_ends_the_fix(scope, water):
    class Swell:
        def elevation(self, x, y, t):
            return 1.0 if t > 1.0 else 0.0

    gps = started(GpsConfig(rate_hz=5))
    high = replace(water, sea=Swell())
    assert gps.sense(at(scope, 0.5, p_NB=(0.0, 0.0, -0.5), water=high)).valid
    assert not gps.sense(at(scope, 1.5, p_NB=(0.0, 0.0, -0.5), water=high)).valid


def test_satellites_are_a_setting(scope):
    gps = started(GpsConfig(rate_hz=5))
    gps.change({"satellites": 3})
    assert not gps.sense(at(scope, 0.0, p_NB=(0.0, 0.0, -1.0))).valid


def test_gps_errors_have_their_size_and_their_memory(scope):
    """Over 40 seeds: standard deviation of the correlated part, and its decay over one correlation time."""
    config = GpsConfig(rate_hz=1, horizontal_sigma_m=2.0, vertical_sigma_m=3.0, tau_s=50.0, velocity_sigma_mps=0.1)
    instant = at(scope, 0.0, p_NB=(0.0, 0.0, -1.0))
    tracks, speeds = [], []
    for seed in range(40):
        gps = started(config, seed, dt=10.0)
        readings = [gps.sense(instant).values for _ in range(200)]
        north, east = north_east(
            np.array([r[0] for r in readings]), np.array([r[1] for r in readings]), EARTH.latitude, EARTH.longitude
        )
        x, y, z = instant.position(MOUNT.p)
        tracks.append([north - x, east - y, np.array([r[2] for r in readings]) + z])
        speeds.append([r[3] for r in readings])
    errors = np.array(tracks)
    assert errors[:, :2].std() == pytest.approx(2.0, rel=0.06)
    assert errors[:, 2].std() == pytest.approx(3.0, rel=0.08)
    assert np.std(speeds) == pytest.approx(0.1, rel=0.02)
    lag = (errors[:, :2, 5:] * errors[:, :2, :-5]).mean() / errors[:, :2].var()
    assert lag == pytest.approx(math.exp(-1.0), abs=0.06)


# -- magnetometer, attitude, clock ------------------------------------------------------------------------------------------------------


def test_ideal_magnetometer_equals_the_field(scope):
    iron = ((1.1, 0.0, 0.0), (0.0, 0.9, 0.0), (0.0, 0.1, 1.0))
    config = MagnetometerConfig(rate_hz=10, ideal=True, hard_iron_T=(1e-6, 0, 0), soft_iron=iron)
    instant = at(scope, 0.0, p_NB=(900.0, 50.0, 5.0), q_NB=Q)
    (field,) = started(config).sense(instant).values
    back = rotate(instant.attitude(MOUNT.q), field)
    assert back == pytest.approx(EARTH.magnetic_field(instant.position(MOUNT.p)), abs=1e-18)


def test_iron_distorts(scope):
    iron = ((1.1, 0.0, 0.0), (0.0, 0.9, 0.0), (0.0, 0.1, 1.0))
    config = MagnetometerConfig(rate_hz=10, hard_iron_T=(1e-6, 2e-6, 3e-6), soft_iron=iron)
    (field,) = started(config, mount=Pose()).sense(at(scope, 0.0)).values
    x, y, z = EARTH.magnetic_field((1.0, 2.0, 5.0))
    assert field == pytest.approx((1.1 * x + 1e-6, 0.9 * y + 2e-6, 0.1 * y + z + 3e-6), abs=1e-15)


def test_ideal_attitude_equals_the_truth(scope):
    config = AttitudeConfig(rate_hz=10, ideal=True, tilt_sigma_deg=3.0, heading_turn_on_deg=5.0, settling_s=9.0)
    reading = started(config, mount=Pose()).sense(at(scope, 0.0, q_NB=quat_from_rpy(0.1, 0.2, -0.5)))
    assert reading.valid
    assert reading.values[0] == quat_from_rpy(0.1, 0.2, -0.5)
    assert reading.values[1] == pytest.approx(2 * math.pi - 0.5, abs=1e-9)


def test_magnetic_heading_is_less_by_the_declination(scope):
    config = AttitudeConfig(rate_hz=10, north="magnetic")
    reading = started(config, mount=Pose()).sense(at(scope, 0.0, q_NB=quat_from_rpy(0, 0, 1.0)))
    assert reading.values[1] == pytest.approx(1.0 - EARTH.declination, abs=1e-9)


@pytest.mark.parametrize(("secant", "factor"), [(False, 1.0), (True, 1.0 / math.cos(rad(63.43)))])
def test_heading_errors_and_the_secant_of_the_latitude(scope, secant, factor):
    config = AttitudeConfig(
        rate_hz=10, heading_sigma_deg=0.3, heading_turn_on_deg=0.4, tilt_sigma_deg=0.2, secant_latitude=secant
    )
    instant = at(scope, 0.0, q_NB=quat_from_rpy(0, 0, 1.0))
    readings = [started(config, seed, mount=Pose()).sense(instant).values for seed in range(3000)]
    heading = np.array([r[1] for r in readings]) - 1.0
    assert deg(heading.std()) == pytest.approx(0.5 * factor, rel=0.05)
    tilt = [2.0 * math.hypot(r[0][1], r[0][2]) for r in readings]
    assert deg(math.sqrt(np.mean(np.square(tilt)) / 2)) == pytest.approx(0.2, rel=0.05)


def test_a_gyrocompass_settles_first(scope):
    config = AttitudeConfig(rate_hz=10, settling_s=300.0)
    assert started(config).sense(at(scope, 299.9)).values == [(None,) * 4, None]
    assert started(config).sense(at(scope, 300.0)).valid


def test_clock(scope):
    exact = started(ClockConfig(rate_hz=1, ideal=True, offset_s=5.0)).sense(at(scope, 12.5))
    assert exact.values == [1_767_225_612_500_000_000, 12.5]
    drifting = started(ClockConfig(rate_hz=1, offset_s=0.25, drift=2e-5)).sense(at(scope, 1000.0))
    assert drifting.values[1] == pytest.approx(1000.0 + 0.25 + 0.02, abs=1e-9)
    drawn = [
        started(ClockConfig(rate_hz=1, drift_sigma=1e-5), seed).sense(at(scope, 1000.0)).values[1]
        for seed in range(1000)
    ]
    assert np.std(drawn) == pytest.approx(0.01, rel=0.07)


# -- water ------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("z", [1.0, 13.7, 19.0, 500.0])
def test_ideal_ctd_and_sound_speed_equal_the_truth(scope, z):
    instant = at(scope, 0.0, p_NB=(0.0, 0.0, z), water=SEA)
    ctd = CtdConfig(rate_hz=16, ideal=True, temperature_lag_s=9.0, temperature_accuracy_degc=1.0)
    conductivity, temperature, pressure, salinity = started(ctd, mount=Pose()).sense(instant).values
    assert temperature == SEA.temperature_at(z)
    assert pressure == SEA.pressure((0.0, 0.0, z), 0.0)
    assert salinity == pytest.approx(SEA.salinity_at(z), abs=1e-9)
    sea = (pressure - SEA.atmospheric_pressure) / 1e4
    assert conductivity == pytest.approx(0.1 * gsw.C_from_SP(SEA.salinity_at(z), temperature, sea), abs=1e-9)
    (c,) = started(SoundSpeedConfig(rate_hz=8, ideal=True, accuracy_mps=1.0), mount=Pose()).sense(instant).values
    assert c == SEA.sound_speed(z)


@pytest.mark.parametrize("salinity", [0.05, 1.9, 2.1, 20.0, 35.0, 41.0])
@pytest.mark.parametrize(("t", "p"), [(0.0, 0.0), (15.0, 100.0), (25.0, 5000.0)])
def test_practical_salinity_agrees_with_gsw(salinity, t, p):
    assert practical_salinity(0.1 * gsw.C_from_SP(salinity, t, p), t, p) == pytest.approx(salinity, abs=1e-9)


def test_lags_make_a_spike_of_salinity(scope):
    """Falling through a thermocline with a thermistor slower than the cell: temperature reads too warm, salinity too fresh."""
    fast = TableColumn(depth_m=(0.0, 10.0, 12.0, 50.0), temperature_degc=(18, 18, 8, 8), salinity_psu=(34, 34, 34, 34))
    water = Water(1025.0, 9.81, 18.0, 101_325.0, (0, 0, 0), given=WaterColumn(fast, 9.81, 1025.0))
    ctd = started(CtdConfig(rate_hz=16, temperature_lag_s=0.5, conductivity_lag_s=0.05), mount=Pose())
    salinity = [ctd.sense(at(scope, k / 16, p_NB=(0.0, 0.0, 9.0 + k / 16), water=water)).values[3] for k in range(160)]
    assert min(salinity) < 33.0
    assert salinity[0] == pytest.approx(34.0, abs=1e-3)
    assert salinity[-1] == pytest.approx(34.0, abs=0.01)


@pytest.mark.parametrize("config", [CtdConfig(rate_hz=16), SoundSpeedConfig(rate_hz=16)])
def test_in_air_there_is_no_water_to_measure(scope, config):
    assert not started(config).sense(at(scope, 0.0, p_NB=(0.0, 0.0, -2.0))).valid


def test_ctd_statistics(scope):
    config = CtdConfig(rate_hz=16, temperature_accuracy_degc=0.01, temperature_sigma_degc=0.002, pressure_sigma_Pa=50.0)
    instant = at(scope, 0.0, p_NB=(0.0, 0.0, 5.0), water=SEA)
    biases, spread = [], []
    for seed in range(400):
        ctd = started(config, seed, mount=Pose())
        values = np.array([ctd.sense(instant).values for _ in range(50)])
        biases.append(values[:, 1].mean() - 18.0)
        spread.append(values.var(axis=0, ddof=1))
    assert np.std(biases) == pytest.approx(0.01, rel=0.08)
    assert np.sqrt(np.mean(spread, axis=0))[[1, 2]] == pytest.approx([0.002, 50.0], rel=0.03)


# -- IMU --------------------------------------------------------------------------------------------------------------------------------


def test_an_ideal_imu_is_exact_whatever_the_profile(scope):
    errors = TriadErrors(noise_density=1.0, turn_on=1.0, scale=0.5, instability=1.0)
    instant = at(scope, 0.0, q_NB=Q, w_NB_B=(0.1, 0.2, 0.3))
    ideal = started(ImuConfig(rate_hz=100, ideal=True, gyroscope=errors, accelerometer=errors)).sense(instant)
    assert ideal.values == started(ImuConfig(rate_hz=100)).sense(instant).values


def allan(record, dt, m):
    """Overlapping Allan deviation of (n, runs) readings at m dt."""
    angle = np.vstack([np.zeros(record.shape[1]), np.cumsum(record, axis=0)]) * dt
    second = angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m]
    return math.sqrt(np.mean(second**2) / (2 * (m * dt) ** 2))


def record(errors, n, dt, triads=60):
    """(n, 3 triads) readings of a triad at rest."""
    columns = []
    for seed in range(triads):
        rng = stream_of(seed, "rov/imu")
        triad = Triad(errors)
        memory = triad.turn_on(rng)
        columns.append([triad.read((0.0, 0.0, 0.0), memory, 0, dt, rng) for _ in range(n)])
    return np.concatenate([np.array(column) for column in columns], axis=1)


def test_allan_noise():
    """N on a record of 60 x 3 x 2000 x 0.01 s."""
    found = record(TriadErrors(noise_density=2e-3), 2000, 0.01)
    for m in (1, 10, 40):
        assert allan(found, 0.01, m) * math.sqrt(m * 0.01) == pytest.approx(2e-3, rel=0.05)


def test_allan_instability():
    """B at the hump of 1.89 tau; the records together are 180 x 150 tau long, 14 000 times the fitting time."""
    tau, dt = 100.0, 5.0
    found = record(TriadErrors(instability=3e-5, instability_tau_s=tau), 3000, dt)
    deviations = {m: allan(found, dt, m) for m in (10, 20, 38, 80, 160)}
    assert max(deviations, key=deviations.get) == 38
    assert deviations[38] == pytest.approx(3e-5, rel=0.1)
    assert HUMP == 0.618


def test_allan_random_walk():
    """K on the slope +1/2, read at 3 s."""
    found = record(TriadErrors(random_walk=5e-4), 3000, 0.1)
    for m in (10, 30, 100):
        assert allan(found, 0.1, m) * math.sqrt(3 / (m * 0.1)) == pytest.approx(5e-4, rel=0.1)


GRADES = ("mems_imu", "tactical_imu", "fog_imu")


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("part", ["gyroscope", "accelerometer"])
def test_every_grade_gives_back_its_figures(grade, part):
    """N within 5 %, B and K within 10 %, each on records of 500 times the averaging time at which it is read; no range and no steps."""
    keys = check_profile(
        msgspec.toml.decode(shipped("devices")[grade].read_bytes()), lambda *problem: pytest.fail(str(problem))
    )
    errors = msgspec.convert(keys[part], TriadErrors)
    noise = record(TriadErrors(noise_density=errors.noise_density), 5000, 0.1, triads=2)
    assert allan(noise, 0.1, 10) == pytest.approx(errors.noise_density, rel=0.05)
    if errors.instability:
        tau = errors.instability_tau_s
        alone = TriadErrors(instability=errors.instability, instability_tau_s=tau)
        wander = record(alone, 500 * 19, tau / 10.0, triads=3)
        assert allan(wander, tau / 10.0, 19) == pytest.approx(errors.instability, rel=0.1)
    density = errors.random_walk or 1e-3 * errors.noise_density
    walk = record(TriadErrors(random_walk=density), 500 * 10, 0.3, triads=4)
    assert allan(walk, 0.3, 10) == pytest.approx(density, rel=0.1)


def test_constants_of_a_run_have_their_spread():
    errors = TriadErrors(turn_on=0.02, scale=0.003, cross_axis=0.001)
    memories = np.array([Triad(errors).turn_on(stream_of(seed, "rov/imu")) for seed in range(2000)])
    matrix = memories[:, :9].reshape(-1, 3, 3) - np.eye(3)
    assert matrix[:, range(3), range(3)].std() == pytest.approx(0.003, rel=0.04)
    assert matrix[:, [0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]].std() == pytest.approx(0.001, rel=0.04)
    assert memories[:, 9:12].std() == pytest.approx(0.02, rel=0.04)


def test_a_triad_reads_through_its_matrix_and_ends_at_its_range():
    triad = Triad(TriadErrors(limit=10.0, resolution=0.5, scale=1e-9))
    memory = [1.0, 0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.25, 0.0, 0.0, *[0.0] * 6]
    assert triad.read((1.0, 2.0, 9.0), memory, 0, 0.01, stream_of(0, "x")) == (1.5, 2.0, 10.0)
