"""Sensors against the truth: exact ones have no error wherever they sit, and noisy ones as much as their tables say."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.recording.report.contents import Contents
from uwserver.recording.report.errors import SensorError
from uwserver.recording.report.reading import Recorded
from uwserver.recording.report.truth import truth_of


def found(contents: Contents, name: str, what: str) -> SensorError:
    return next(e for e in contents.errors if e.path == f"rov/{name}" and e.title == what)


@pytest.mark.parametrize(
    ("name", "what", "most"),
    [
        ("imu_exact", "angular rate", 1e-6), ("imu_exact", "specific force", 2e-5), ("dvl_exact", "velocity over ground", 1e-6),
        ("pressure_exact", "pressure", 0.1), ("ahrs_exact", "attitude", 1e-6), ("gps_exact", "position", 1e-6), ("gps_exact", "velocity", 1e-6),
        ("mocap", "position", 1e-9), ("mocap", "attitude", 1e-6),
    ],
)  # fmt: skip
def test_an_exact_sensor_has_no_error(contents: Contents, name: str, what: str, most: float) -> None:
    error = found(contents, name, what)
    assert len(error.t) > 15
    assert float(np.abs(error.error).max()) < most
    assert error.sigma is None


@pytest.mark.parametrize(
    ("name", "what", "sigma"),
    [
        ("depth_noisy", "depth", 0.01), ("ahrs_noisy", "attitude", 0.5), ("gps_noisy", "position", 0.7), ("gps_noisy", "velocity", 0.1),
        ("imu_noisy", "specific force", 1e-3 * 120**0.5),
    ],
)  # fmt: skip
def test_white_noise_is_as_large_as_configured(contents: Contents, name: str, what: str, sigma: float) -> None:
    error = found(contents, name, what)
    assert error.sigma is not None
    np.testing.assert_allclose(error.sigma, sigma, rtol=1e-6)
    assert error.rms == pytest.approx(sigma, rel=0.2)
    assert error.inside is not None
    assert 0.97 < error.inside <= 1.0


def test_a_constant_error_of_the_run_counts(contents: Contents) -> None:
    error = found(contents, "imu_noisy", "angular rate")
    assert error.sigma is not None
    np.testing.assert_allclose(error.sigma, (1e-6 * 120 + 4e-6) ** 0.5, rtol=1e-6)


def test_the_error_of_a_dvl_is_what_it_expects_itself(contents: Contents) -> None:
    error = found(contents, "dvl_noisy", "velocity over ground")
    assert error.sigma is not None
    assert error.inside is not None
    assert error.inside > 0.95
    assert 0.3 * error.sigma.mean() < error.rms < 2.0 * error.sigma.mean()


def test_truth_at_the_same_ticks_is_taken_as_it_is(recorded: Recorded) -> None:
    truth = truth_of(recorded, "rov")
    assert truth is not None
    t = np.arange(10, 300) / 120.0
    chosen = truth.pairs(t)
    assert len(chosen) == 145  # every second: the truth comes at 60 Hz
    assert len(truth.pairs(t[:20] + 1e-3)) == 20  # none is of the same tick: all are compared with what lies between
    assert len(truth.pairs(t + 1e9)) == 0
