"""Errors of three axes: Allan deviations of noise, instability and random walk, constants of a run, range and steps."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from uwserver.environment.water import Water
from uwserver.physics.kernel.arrays import Pool
from uwserver.physics.kernel.random import key_of
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.vehicle.devices import check_profile
from uwserver.sensors import ImuConfig, Pose, Scope
from uwserver.sensors.compiled import HEAD, read
from uwserver.sensors.motion.imu import Imu, ImuMemory
from uwserver.sensors.motion.triad import HUMP, TriadErrors, TriadMemory
from uwserver.sensors.surroundings import ScopeArrays

STILL = Scope(
    0, (0.0, 0.0, 5.0), (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, Water(1025.0, 9.81, 10.0, 101_325.0, (0.0,) * 3)
)


def allan(record, dt, m):
    """Overlapping Allan deviation of (n, runs) readings at m dt."""
    angle = np.vstack([np.zeros(record.shape[1]), np.cumsum(record, axis=0)]) * dt
    second = angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m]
    return math.sqrt(np.mean(second**2) / (2 * (m * dt) ** 2))


def imus(errors, count, dt):
    """Gyroscopes with these errors, of as many seeds."""
    made = []
    for seed in range(count):
        imu = ImuConfig(rate_hz=1.0 / dt, gyroscope=errors).build(Pose())
        imu.start(key_of(seed, "rov/imu"))
        made.append(imu)
    return made


def record(errors, n, dt, triads=60):
    """(n, 3 triads) readings of gyroscopes at rest."""
    heads, rows = Pool(HEAD, triads), Pool(Imu.kernel.record, triads)
    for imu in imus(errors, triads, dt):
        imu.enter(heads, rows)
    heads.rows["first"], heads.rows["width"], heads.rows["dt"] = 7 * np.arange(triads), 7, dt
    there, numbers, readings = ScopeArrays(STILL), np.zeros(7 * triads), []
    for number in range(n):
        heads.rows["number"] = number
        read(Imu.kernel, heads.rows, rows.rows, numbers, np.arange(triads), there.table, 0.0, STILL.geometry)
        readings.append(numbers.reshape(triads, 7)[:, 3:6].ravel())
    return np.array(readings)


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
    memories = [imu.memory.gyroscope for imu in imus(errors, 2000, 0.01)]
    matrix = np.array([memory.matrix for memory in memories]).reshape(-1, 3, 3) - np.eye(3)
    assert matrix[:, range(3), range(3)].std() == pytest.approx(0.003, rel=0.04)
    assert matrix[:, [0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]].std() == pytest.approx(0.001, rel=0.04)
    assert np.std([memory.turn_on for memory in memories]) == pytest.approx(0.02, rel=0.04)


def test_a_triad_reads_through_its_matrix_and_ends_at_its_range():
    errors = TriadErrors(limit=10.0, resolution=0.5, scale=1e-9)
    imu = imus(errors, 1, 0.01)[0]
    triad = TriadMemory((1.0, 0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0), (0.25, 0.0, 0.0))
    imu.memory = ImuMemory(gyroscope=triad)
    assert imu.sense(replace(STILL, w_NB_B=(1.0, 2.0, 9.0))).values[1] == (1.5, 2.0, 10.0)
    assert imu.memory.gyroscope == triad
