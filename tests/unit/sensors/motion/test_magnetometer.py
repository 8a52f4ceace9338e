"""The magnetometer: exact when ideal, distorted by iron and by the current of the thrusters."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_rig import (
    BATTERY,
    EARTH,
    MOUNT,
    Q,
    at,
    started,
    world_with,
)

from uwserver.frames import rotate
from uwserver.sensors import (
    MagnetometerConfig,
    Pose,
)


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


def test_the_current_of_the_thrusters_disturbs_the_compass():
    """The field moves by a constant vector per ampere that they draw together; at rest, and for an ideal one, by nothing."""
    per_ampere = (1e-7, -2e-7, 3e-7)
    compass = {"rate_hz": 20, "thruster_field_TpA": per_ampere}
    world = world_with(
        battery=BATTERY, compass=MagnetometerConfig(**compass), ideal=MagnetometerConfig(ideal=True, **compass)
    )
    at_rest = {s.port: s.value[0] for s in world.step(48) if s.port in ("rov/compass", "rov/ideal")}
    assert at_rest["rov/compass"] == at_rest["rov/ideal"]
    world.command("rov/thrusters", u=[0.8] * 8)
    under_way = {s.port: s.value[0] for s in world.step(96) if s.port in ("rov/compass", "rov/ideal")}
    wiring = world.sensors["rov/compass"].wiring
    current = wiring.power() / wiring.voltage
    assert current > 20.0
    moved = np.subtract(under_way["rov/compass"], under_way["rov/ideal"])
    assert moved == pytest.approx(np.multiply(per_ampere, current), rel=1e-9)
