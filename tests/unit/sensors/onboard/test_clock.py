"""The clock of a vehicle: UTC, offset and drift."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_rig import (
    at,
    started,
)

from uwserver.sensors import (
    ClockConfig,
)


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
