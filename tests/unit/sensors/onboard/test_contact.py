"""The contact sensor: impulses and places in the frame of the body; a landing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sensor_rig import (
    world_with,
)
from uwserver_bench.proofs.colliders import Floor

from uwserver.frames import quat_from_rpy
from uwserver.sensors import (
    ContactConfig,
    Pose,
)
from uwserver.sensors.wiring import Touch


class Touching:
    def touches(self):
        return [Touch(3, (1.0, 2.0, 6.0), (0.0, 0.0, -4.0)), Touch(-1, (1.5, 2.0, 5.0), (-1.0, 0.0, 0.0))]


def test_contacts_in_the_frame_of_the_body(scope):
    sensor = ContactConfig(rate_hz=10, points=3).build(Pose())
    instant = replace(scope(q_NB=quat_from_rpy(0, 0, math.pi / 2)), wiring=Touching())
    valid, (touching, count, impulse, body, points, impulses) = sensor.measure(instant)
    assert (valid, touching, count, body) == (True, True, 2, 3)
    assert impulse == pytest.approx((0.0, 1.0, -4.0), abs=1e-12)
    assert points[:6] == pytest.approx((0.0, 0.0, 1.0, 0.0, -0.5, 0.0), abs=1e-12)
    assert impulses[:6] == pytest.approx((0.0, 0.0, -4.0, 0.0, 1.0, 0.0), abs=1e-12)
    assert points[6:] == (None,) * 3


def test_nothing_touched(scope):
    valid, values = ContactConfig(rate_hz=10, points=1).build(Pose()).measure(scope())
    assert valid
    assert values == [False, 0, (0.0, 0.0, 0.0), None, (None,) * 3, (None,) * 3]


def test_a_landing_is_felt():
    """At rest on the seabed the contacts carry the weight in water, once a tick."""
    feet = tuple((x, y, 0.12) for x in (-0.2, 0.2) for y in (-0.25, 0.25))
    world = world_with(bump=ContactConfig(rate_hz=240, points=4), depth=-0.5)
    world.hydro.collider = Floor({0: feet})
    world.hydro.bodies["weight"] = 18.0 * 9.81
    world.hydro.state[0, 2] = -0.5  # the floor of the collider is z = 0
    values = [s.value for s in world.step(2400) if s.port == "rov/bump"]
    assert values[0][:2] == (False, 0)
    assert (values[-1][0], values[-1][3]) == (True, -1)
    body = world.hydro.bodies[0]
    total = np.mean([v[2] for v in values[-240:]], axis=0)
    assert total[2] == pytest.approx(-18.0 * 9.81 / 240.0, rel=0.05)
    assert float(body["weight"]) == 18.0 * 9.81
    assert values[-1][4][2] == pytest.approx(0.12, abs=0.02)
