"""Allan deviation of IMU errors: the figures of a data sheet come back out of the record, as somebody who characterises it would find them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.modifiers import GaussMarkov, Measurement, RandomWalk, Stream, WhiteNoise
from uwserver.physics.kernel.random import key_of
from uwserver.ports import Field
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import ImuConfig

DT = 0.01
RUNS = 256


def allan(record: np.ndarray, dt: float, m: int) -> float:
    """Overlapping Allan deviation of (n, runs) readings at the averaging time m dt; mean of variances over the runs."""
    angle = np.vstack([np.zeros(record.shape[1]), np.cumsum(record, axis=0)]) * dt
    second = angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m]
    return math.sqrt(np.mean(second**2) / (2 * (m * dt) ** 2))


def chain(n: int, *configs) -> np.ndarray:
    """(n, RUNS) readings of a gyro with these errors, each component a run of its own."""
    fields = (Field("w_S", "rad/s", "", "S", (RUNS,)),)
    modifiers = [config.build(Stream(fields, DT, key_of(11, f"rov/imu/{k}"))) for k, config in enumerate(configs)]
    record = np.empty((n, RUNS))
    for k in range(n):
        reading = Measurement([(0.0,) * RUNS], True, t_ns=round((k + 1) * DT * 1e9), number=k)
        for modifier in modifiers:
            modifier.apply(reading)
        record[k] = reading.values[0]
    return record


def gauss_markov_allan(sigma: float, tau_c: float, tau: float) -> float:
    """IEEE Std 952-1997, C.1.1: exponentially correlated noise of standard deviation sigma."""
    ratio = tau / tau_c
    return sigma * math.sqrt(2 / ratio * (1 - (3 - 4 * math.exp(-ratio) + math.exp(-2 * ratio)) / (2 * ratio)))


def test_white_noise_density():
    """N stands at 1 s on the slope -1/2."""
    record = chain(2000, WhiteNoise(field="w_S", density=2e-3))
    for m in (1, 10, 100):
        assert allan(record, DT, m) * math.sqrt(m * DT) == pytest.approx(2e-3, rel=0.05)


def test_random_walk_density():
    """K stands at 3 s on the slope +1/2."""
    record = chain(4000, RandomWalk(field="w_S", density=5e-4))
    for m in (50, 200, 500):
        assert allan(record, DT, m) * math.sqrt(3 / (m * DT)) == pytest.approx(5e-4, rel=0.1)


def test_gauss_markov_has_its_hump():
    """Bias instability's stand-in: 0.618 sigma at 1.89 tau, slopes +1/2 before and -1/2 after."""
    sigma, tau_c = 3e-3, 1.0
    record = chain(4000, GaussMarkov(field="w_S", sigma=sigma, tau_s=tau_c))
    found = {m: allan(record, DT, m) for m in (20, 60, 189, 500, 1000)}
    assert max(found, key=found.get) == 189
    assert found[189] == pytest.approx(0.618 * sigma, rel=0.05)
    for m, deviation in found.items():
        assert deviation == pytest.approx(gauss_markov_allan(sigma, tau_c, m * DT), rel=0.05)


def test_errors_of_one_chain_add_in_variance():
    noise, wander = WhiteNoise(field="w_S", density=2e-3), RandomWalk(field="w_S", density=2e-3)
    record = chain(2000, noise, wander)
    assert allan(record, DT, 2) * math.sqrt(2 * DT) == pytest.approx(2e-3, rel=0.05)
    assert allan(record, DT, 400) == pytest.approx(math.sqrt(2e-3**2 / 4 + 2e-3**2 * 4 / 3), rel=0.1)


@pytest.mark.parametrize(
    ("column", "density", "step"), [(0, 9.81e-4, 4.79e-3), (1, 6.98e-5, 1.065e-3)], ids=["accelerometer", "gyro"]
)
def test_the_shipped_imu_has_the_noise_of_its_data_sheet(shipped_imu, column, density, step):
    """Through the world: vehicle file, device file, loader, sample; 100 s of the ROV's IMU less an ideal one beside it.

    Rounding to its 16 bits adds white noise of a twelfth of the step squared.
    """
    error = shipped_imu[:, column]
    density = math.hypot(density, step / math.sqrt(12 * 120))
    for m in (1, 12, 60):
        assert allan(error, 1 / 120, m) * math.sqrt(m / 120) == pytest.approx(density, rel=0.05)


@pytest.fixture(scope="module")
def shipped_imu() -> np.ndarray:
    """(n, 2, 3) errors of f_S and w_S."""
    entry = VehicleEntry(
        model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 50.0), sensors={"ideal": ImuConfig(rate_hz=120)}
    )
    world = build(load(Scenario(schema=1, seed=2, vehicles={"rov": entry}), adapters={}))
    values: dict[str, dict[int, tuple]] = {"rov/imu": {}, "rov/ideal": {}}
    for sample in world.step(24_000):
        if sample.port in values:
            values[sample.port][sample.t_ns] = sample.value[:2]
    ideal = values["rov/ideal"]
    return np.array([np.subtract(value, ideal[t]) for t, value in values["rov/imu"].items()])
