"""The leak probe: how long a leak takes to wet it."""

from __future__ import annotations

import math

import pytest
from sensor_rig import (
    last,
    world_with,
)

from uwserver.sensors import (
    LeakConfig,
)


def test_a_leak_fills_until_the_probe_is_wet():
    """A sqrt(2 g h) 0.6: through 1 mm2 at 20 m 12 ml a second."""
    world = world_with(leak=LeakConfig(rate_hz=10, threshold_m3=6e-5))
    assert last(world, "leak", 480) == (False,)
    world.call("rov/leak/set", area_m2=1e-6)
    wet = [s.value[0] for s in world.step(2400) if s.port == "rov/leak"]
    assert wet.index(True) / 10 == pytest.approx(6e-5 / (0.6e-6 * math.sqrt(2 * 9.81 * 20.0)), abs=0.15)
    world.call("world/reset")
    assert last(world, "leak", 240) == (False,)
