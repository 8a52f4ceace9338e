"""The head that steps: its angles follow from settings and memory alone, whatever these are set to meanwhile."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.frames import IDENTITY, quat_from_rpy
from uwserver.sensors.acoustic.head import axes, head_arguments, step_on
from uwserver.sensors.acoustic.imaging.blocks import turn


def steps(count: int, **sector: float) -> list[float]:
    asked = {"step": 0.1, "sector_center": 0.0, "sector_width": 0.4, **sector}.values()
    index, sense, angles = 0, 1, []
    for _ in range(count):
        angle, index, sense = step_on(*asked, index, sense)
        angles.append(angle)
    return angles


def test_to_and_fro_on_and_on_or_not_at_all() -> None:
    assert steps(7) == pytest.approx([-0.2, -0.1, 0.0, 0.1, 0.2, 0.1, 0.0])
    assert steps(3, sector_width=0.0, sector_center=0.3) == pytest.approx([0.3] * 3)
    around = steps(63, sector_width=2.0 * math.pi)
    assert around[62] == pytest.approx(around[0] + 62 * 2.0 * math.pi / 63 - 2.0 * math.pi, abs=0.05)


def test_a_narrower_sector_takes_the_head_in() -> None:
    angle, index, sense = step_on(0.1, 0.0, 0.4, 500, 1)
    assert angle == pytest.approx(0.2)
    assert (index, sense) == (3, -1)


def test_axes_turn_from_x_to_y() -> None:
    R, out = np.empty((3, 3)), np.empty(3)
    axes(IDENTITY, 0.5 * math.pi, R)
    turn(R, np.array((1.0, 0.0, 0.0)), out)
    assert out == pytest.approx((0.0, 1.0, 0.0))
    axes(quat_from_rpy(0.0, 0.0, 0.4), -0.4, R)
    assert np.allclose(R, np.eye(3))
    assert head_arguments(0.1)[2].minimum == 0.1


@pytest.mark.parametrize("turns", [-2.0, 1.0, 5.0])
def test_angles_are_those_of_one_turn(turns: float) -> None:
    """Whatever the middle of the sector is called."""
    whole = 2.0 * math.pi
    around = steps(80, sector_width=whole, sector_center=turns * whole + 3.0)
    assert all(-math.pi <= angle <= math.pi for angle in around)
    assert np.exp(1j * np.array(around)) == pytest.approx(np.exp(1j * (3.0 + 0.1 * (np.arange(80) % 63))))
