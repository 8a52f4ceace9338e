"""What a current profiler makes of its beams, in closed forms: points and weights of cells, ambiguity, levels of one depth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.acoustic.current_profile import (
    LINEAR,
    NEAREST,
    OFF,
    at_level,
    mapping_of,
    point_of,
    weigh,
    wrap,
)


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


@pytest.mark.parametrize(
    ("down", "is_mapped"),
    [
        ((1.0, 0.8, 1.2), True),
        ((-1.0, -0.8, -1.2), True),
        ((1.0, 1.0, 0.29), False),
        ((1.0, 1.0, -1.0), False),
        ((-1.0, 1.0, 1.0), False),
    ],
)
def test_beams_beside_the_vertical_are_not_mapped(down, is_mapped):
    for mapping in (NEAREST, LINEAR):
        assert mapping_of(np.array(down), mapping) == (mapping if is_mapped else OFF)


def levels(column, down, mapping, blanking=0.5, cell=1.0):
    """All of them; nan for none."""
    return [at_level(np.array(column), down, k, blanking, cell, mapping) for k in range(len(column))]


@pytest.mark.parametrize("mapping", [OFF, NEAREST, LINEAR])
@pytest.mark.parametrize("down", [1.0, -1.0, 1.0 - 1e-15, 1.0 + 1e-15])
def test_a_level_device_keeps_its_cells(mapping, down):
    """Rounding brings in no neighbour, which may be missing."""
    for column in ([3.0, 1.0, 4.0, 1.5], [3.0, math.nan, 4.0, math.nan], [7.0]):
        assert levels(column, down, mapping) == pytest.approx(column, nan_ok=True)


def test_linear_mapping_of_what_is_linear_is_exact():
    """A beam whose cells are 1 / down of a level apart; the last cells serve half of themselves farther out."""
    down, blanking, cell = 0.8, 0.4, 2.0
    z = blanking + cell * np.arange(1, 6)
    told = levels(3.0 * down * z - 1.0, down, LINEAR, blanking, cell)
    there = z / down <= z[-1] + 0.5 * cell
    assert np.array(told)[there] == pytest.approx(3.0 * z[there] - 1.0)
    assert (np.isnan(told) == ~there).all()
    assert 2 <= there.sum() < 5


def test_the_nearest_cell_is_taken_as_it_is():
    """Levels at 1.5 ... 4.5 m lie 1.875, 3.125, 4.375 and 5.625 m along a beam with down = 0.8, whose cells have their middles at 1.5 ... 4.5 m."""
    assert levels([1.0, 2.0, 3.0, 4.0], 0.8, NEAREST) == pytest.approx([1.0, 3.0, 4.0, math.nan], nan_ok=True)


def test_a_missing_neighbour_of_weight_makes_a_level_missing():
    assert math.isnan(at_level(np.array([1.0, math.nan, 3.0]), 0.8, 0, 0.5, 1.0, LINEAR))
