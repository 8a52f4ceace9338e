"""Slanted beams: least squares as of numpy's pseudo-inverse, none for beams in one plane, and levels of one depth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.acoustic.doppler.janus import (
    LINEAR,
    NEAREST,
    OFF,
    altitude_of,
    at_level,
    count_values,
    inverse_of,
    mapping_of,
    vector_of,
)


def beams(angle_deg, *azimuths_deg):
    angle, azimuths = math.radians(angle_deg), np.radians(azimuths_deg)
    across = math.sin(angle)
    return np.stack([across * np.cos(azimuths), across * np.sin(azimuths), np.full(len(azimuths), math.cos(angle))], 1)


JANUS = beams(20.0, 45.0, 135.0, 225.0, 315.0)
CASES = [
    JANUS,
    beams(30.0, 0.0, 120.0, 240.0),
    beams(3.0, 0.0, 72.0, 144.0, 216.0, 288.0),
    beams(25.0, 0.0, 20.0, 120.0, 240.0),
]


@pytest.mark.parametrize("directions", CASES, ids=["janus", "three", "narrow", "uneven"])
@pytest.mark.parametrize("lost", [None, 0, 1, 2])
def test_least_squares_are_those_of_the_pseudo_inverse(directions, lost):
    told = np.random.default_rng(4).normal(size=len(directions))
    if lost is not None and len(directions) > 3:
        told[lost] = math.nan
    there = np.isfinite(told)
    expected = np.linalg.pinv(directions[there]) @ told[there]
    assert count_values(told) == there.sum()
    found = vector_of(directions, inverse_of(directions, told), told)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.2, -0.1, -0.9)])
def test_the_altitude_is_that_of_a_plane_along_the_axis(normal):
    ranges = np.array([12.0 * normal[2] / np.dot(normal, beam) for beam in JANUS])
    for lost in (None, 2):
        if lost is not None:
            ranges[lost] = math.nan
        assert altitude_of(JANUS, inverse_of(JANUS, ranges), ranges) == pytest.approx(12.0, rel=1e-13)


def test_beams_in_one_plane_give_no_vector():
    """Two of them that point to the same side, as one in four may be lost."""
    directions = beams(20.0, 0.0, 360.0, 120.0, 240.0)
    told = np.array([1.0, 1.0, 0.5, math.nan])
    spread = inverse_of(directions, told)
    assert np.isnan(vector_of(directions, spread, told)).all()
    assert math.isnan(altitude_of(directions, spread, 5.0 * told))
    assert np.isfinite(vector_of(directions, inverse_of(directions, np.ones(4)), np.ones(4))).all()


def test_ranges_of_no_plane_before_the_device_give_no_altitude():
    """One beam meets something so near that the plane would lie behind."""
    ranges = np.array([0.1, math.nan, 50.0, 50.0])
    behind = beams(60.0, 0.0, 90.0, 100.0, 110.0)
    assert altitude_of(behind, inverse_of(behind, ranges), ranges) > 0.0
    ranges = np.array([50.0, math.nan, 0.1, 50.0])
    assert math.isnan(altitude_of(behind, inverse_of(behind, ranges), ranges))


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
