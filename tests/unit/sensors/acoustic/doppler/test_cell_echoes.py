"""Cells of a current profiler in closed forms: their points and weights, and the ambiguity of velocities."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.acoustic.doppler.cell_echoes import point_of, weigh, wrap


def test_points_lie_in_the_cells():
    """Three cells of 1 m behind half a metre: their middles are at 1.5, 2.5 and 3.5 m."""
    assert [point_of(0.5, 1.0, j) for j in range(7)] == pytest.approx([1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0])


def test_the_weights_of_a_cell_have_the_moments_of_a_triangle():
    """Of half width h: 1, 0, h^2 / 6 and 0, here with h = 1 and points half a metre apart."""
    for power, moment in enumerate((1.0, 0.0, 1.0 / 6.0, 0.0)):
        assert weigh((-0.5) ** power, 0.0**power, 0.5**power) == pytest.approx(moment, abs=1e-15)
    assert math.isnan(weigh(1.0, 1.0, math.nan))


def test_wrapping_keeps_what_is_inside():
    for inside in np.linspace(-0.99, 0.99, 7).tolist():
        for turn in (-4.0, -2.0, 0.0, 2.0, 6.0):
            assert wrap(inside + turn, 1.0) == pytest.approx(inside)


def test_what_is_beyond_comes_back_on_the_other_side():
    assert wrap(1.25, 1.0) == -0.75
    assert wrap(-1.25, 1.0) == 0.75
