"""What sonars that ping share: limits of settings, and the fade of speckle."""

from __future__ import annotations

import math

import pytest

from uwserver.sensors import Pose, SideScanConfig
from uwserver.sensors.acoustic.pinging import fade_of


def test_the_service_has_the_limits_of_the_table() -> None:
    sonar = SideScanConfig(rate_hz=1, min_range_m=5.0, max_range_m=75.0, gain_db=2.0).build(Pose())
    limits = {argument.name: (argument.minimum, argument.maximum) for argument in sonar.arguments}
    assert limits == {"range": (5.0, 75.0), "gain": (-60, 60)}
    assert sonar.properties() == {"range": 50.0, "gain": 2.0}


def test_a_range_that_is_out_of_the_limits_is_told_with_them() -> None:
    with pytest.raises(ValueError, match="range_m is 90, the sonar takes 5 to 75"):
        SideScanConfig(rate_hz=1, min_range_m=5.0, max_range_m=75.0, range_m=90.0)
    with pytest.raises(ValueError, match="min_range_m is 80 and max_range_m 75"):
        SideScanConfig(rate_hz=1, min_range_m=80.0, max_range_m=75.0, range_m=50.0)


def test_speckle_fades_in_half_a_transducer() -> None:
    """A beam of 1 degree at 450 kHz is made by 0.169 m (0.886 wavelengths over the angle)."""
    length, turn = fade_of(math.radians(1.0), 450e3)
    assert 2.0 * length == pytest.approx(0.169, abs=5e-4)
    assert turn == pytest.approx(math.radians(0.8))
