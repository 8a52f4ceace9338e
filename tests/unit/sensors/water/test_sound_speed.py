"""Sound velocity: exact when ideal, nothing in air, and the statistics of its errors."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_rig import SEA, at, started

from uwserver.sensors import Pose, SoundSpeedConfig


@pytest.mark.parametrize("z", [1.0, 13.7, 19.0, 500.0])
def test_an_ideal_one_equals_the_truth(scope, z):
    config = SoundSpeedConfig(rate_hz=8, ideal=True, accuracy_mps=1.0, sigma_mps=1.0)
    reading = started(config, mount=Pose()).sense(at(scope, 0.0, p_NB=(0.0, 0.0, z), water=SEA))
    assert reading.values == [SEA.sound_speed(z)]


def test_in_air_there_is_no_water_to_measure(scope):
    assert not started(SoundSpeedConfig(rate_hz=16)).sense(at(scope, 0.0, p_NB=(0.0, 0.0, -2.0))).valid


def test_errors_have_their_size(scope):
    instant = at(scope, 0.0, p_NB=(0.0, 0.0, 5.0), water=SEA)
    config = SoundSpeedConfig(rate_hz=8, accuracy_mps=0.5, sigma_mps=0.02)
    runs = []
    for seed in range(400):
        sensor = started(config, seed, mount=Pose())
        runs.append([sensor.sense(instant).values[0] for _ in range(8)])
    errors = np.array(runs) - SEA.sound_speed(5.0)
    assert errors.mean(axis=1).std() == pytest.approx(0.5, rel=0.17)
    assert np.sqrt(errors.var(axis=1, ddof=1).mean()) == pytest.approx(0.02, rel=0.07)
