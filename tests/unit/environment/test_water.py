"""Hydrostatics."""

from __future__ import annotations

import pytest

from uwserver.environment.water import Water
from uwserver.units import STANDARD_ATMOSPHERE_PA

SEA = Water(
    density=1025.0, gravity=9.81, temperature=10.0, atmospheric_pressure=STANDARD_ATMOSPHERE_PA, current=(0.0, 0.0, 0.0)
)


@pytest.mark.parametrize(
    ("z", "pressure"),
    [(-100.0, 101_325.0), (0.0, 101_325.0), (10.0, 201_877.5), (10_000.0, 101_325.0 + 100_552_500.0)],
)
def test_pressure(z, pressure):
    assert SEA.pressure((3.0, -4.0, z), 5.0) == pytest.approx(pressure, rel=1e-12)


def test_pressure_is_continuous_at_the_surface():
    assert SEA.pressure((0.0, 0.0, 1e-9), 0.0) - SEA.pressure((0.0, 0.0, -1e-9), 0.0) == pytest.approx(0.0, abs=1e-4)
