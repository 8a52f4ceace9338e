"""What is known of the bottom: its slope, echoes that are false, and those that are not."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from uwserver.autopilot.bottom import correct_bottom, fall
from uwserver.autopilot.state import NEVER
from uwserver.frames import quat_from_rpy

STEP_NS = 10**8
DOWN = SimpleNamespace(p=np.zeros(3), q=np.array([1.0, 0.0, 0.0, 0.0]))
update, falls = correct_bottom.py_func, fall.py_func


class Rig:
    """A vehicle with a beam, ten echoes a second; between two of them the bottom goes on as its slope says."""

    def __init__(self, v=(0.0, 0.0, 0.0), pitch=0.0):
        self.e = SimpleNamespace(
            p=[0.0, 0.0, 10.0], v=list(v), q=np.array(quat_from_rpy(0.0, pitch, 0.0)), bottom=math.nan, grade=[0.0, 0.0], strange=0, altitude_ns=NEVER
        )  # fmt: skip
        self.t_ns = 0

    def hear(self, reach):
        self.t_ns += STEP_NS
        for k in range(3):
            self.e.p[k] += 0.1 * self.e.v[k]
        self.e.bottom += 0.1 * falls(self.e)
        update(self.e, DOWN, reach, self.t_ns, 0.0)


def test_a_slope_is_learnt_on_the_way_and_is_one_of_north_and_east():
    rig = Rig(v=(0.6, 0.8, 0.0))
    for _ in range(100):
        north, east, down = (x + 0.1 * v for x, v in zip(rig.e.p, rig.e.v, strict=True))
        rig.hear(30.0 - 0.3 * north + 0.1 * east - down)
    assert falls(rig.e) == pytest.approx(-0.6 * 0.3 + 0.8 * 0.1, abs=0.005)
    rig.e.v = [-0.6, -0.8, 0.0]
    assert falls(rig.e) == pytest.approx(0.1, abs=0.005), "turned round, it falls"


def test_a_tilted_beam_over_a_slope_tells_the_depth_under_the_vehicle():
    """Nose up by the angle of the slope, the beam is square to it and meets it ahead."""
    angle = math.radians(20.0)
    rig = Rig(v=(1.0, 0.0, 0.0), pitch=angle)
    for _ in range(150):
        north = rig.e.p[0] + 0.1
        rig.hear((18.0 - math.tan(angle) * north - 10.0) * math.cos(angle))
    assert rig.e.bottom == pytest.approx(18.0 - math.tan(angle) * rig.e.p[0], abs=0.05)


def test_an_echo_from_behind_does_not_make_the_slope_swing():
    """Nose down on a slope that falls: were the slope turned about the vehicle, each echo would make its error larger."""
    slope, pitch = math.tan(math.radians(10.0)), math.radians(-14.0)
    rig = Rig(v=(1.0, 0.0, 0.0), pitch=pitch)
    for _ in range(300):
        rig.e.v[2] = 0.0
        north = rig.e.p[0] + 0.1
        rig.e.p[2] = slope * north
        # Where the beam, which looks back by 14 degrees, meets a bottom that is 12 m below the vehicle.
        rig.hear(12.0 / (math.cos(pitch) - slope * math.sin(pitch)))
    assert falls(rig.e) == pytest.approx(slope, abs=0.005)
    assert rig.e.bottom - rig.e.p[2] == pytest.approx(12.0, abs=0.05)


def test_a_false_echo_is_not_believed_and_a_cliff_is():
    rig = Rig()
    for _ in range(20):
        rig.hear(8.0)
    seen = rig.e.altitude_ns
    for _ in range(3):
        rig.hear(16.0)
    assert rig.e.bottom == pytest.approx(18.0)
    assert rig.e.altitude_ns == seen, "nor does it count as one"
    rig.hear(8.0)
    for _ in range(4):
        rig.hear(2.0)
    assert rig.e.bottom == pytest.approx(12.0)


def test_a_vehicle_that_rests_learns_no_slope_from_noise():
    rig = Rig(v=(0.05, 0.0, 0.0))
    for k in range(200):
        rig.hear(8.0 + (0.05 if k % 2 else -0.05))
    assert rig.e.grade == [0.0, 0.0]


@pytest.mark.parametrize("reach", [math.nan, math.inf, -1.0])
def test_nothing_heard_tells_nothing(reach):
    rig = Rig()
    rig.hear(reach)
    assert (rig.e.altitude_ns, math.isnan(rig.e.bottom)) == (NEVER, True)
