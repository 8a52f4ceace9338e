"""Free motion against trajectories that two independent authors integrated to far tighter tolerances."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from uwserver.validation.oracle import OracleResult, validate


@pytest.mark.parametrize(
    ("name", "rate_hz", "metres", "degrees"),
    [
        ("bluerov2_heavy_6axis_60s", 240, 1e-6, 1e-5),
        ("kirchhoff_free_60s", 240, 1e-6, 1e-5),
        ("work_class_full_60s", 240, 5e-6, 5e-5),
        ("spheroid_1", 1000, 1e-6, 1e-5),
        ("spheroid_2", 1000, 1e-6, 1e-5),
        ("spheroid_3", 1000, 1e-6, 1e-5),
    ],
)
def test_free_motion_meets_the_oracle(oracles: Path, name: str, rate_hz: float, metres: float, degrees: float) -> None:
    result = validate(oracles / f"{name}.json", rate_hz)
    assert result.position.error <= metres
    assert result.attitude.error <= degrees


def test_order_of_convergence_is_four(oracles: Path) -> None:
    errors: list[OracleResult] = [validate(oracles / "kirchhoff_free_60s.json", rate) for rate in (60, 120, 240)]
    for quantity in ("position", "attitude", "linear_velocity", "angular_velocity"):
        coarse, middle, fine = (getattr(result, quantity).error for result in errors)
        assert math.log2(coarse / middle) >= 3.8, quantity
        assert math.log2(middle / fine) >= 3.8, quantity
