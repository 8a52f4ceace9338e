"""Vectors and altitudes by least squares over slanted beams: as numpy's pseudo-inverse gives them, and none of beams in one plane."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.acoustic.janus import altitude_of, spread_of, told_by, vector_of


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
    assert told_by(told) == there.sum()
    found = vector_of(directions, spread_of(directions, told), told)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.2, -0.1, -0.9)])
def test_the_altitude_is_that_of_a_plane_along_the_axis(normal):
    ranges = np.array([12.0 * normal[2] / np.dot(normal, beam) for beam in JANUS])
    for lost in (None, 2):
        if lost is not None:
            ranges[lost] = math.nan
        assert altitude_of(JANUS, spread_of(JANUS, ranges), ranges) == pytest.approx(12.0, rel=1e-13)


def test_beams_in_one_plane_give_no_vector():
    """Two of them that point to the same side, as one in four may be lost."""
    directions = beams(20.0, 0.0, 360.0, 120.0, 240.0)
    told = np.array([1.0, 1.0, 0.5, math.nan])
    spread = spread_of(directions, told)
    assert np.isnan(vector_of(directions, spread, told)).all()
    assert math.isnan(altitude_of(directions, spread, 5.0 * told))
    assert np.isfinite(vector_of(directions, spread_of(directions, np.ones(4)), np.ones(4))).all()


def test_ranges_of_no_plane_before_the_device_give_no_altitude():
    """One beam meets something so near that the plane would lie behind."""
    ranges = np.array([0.1, math.nan, 50.0, 50.0])
    behind = beams(60.0, 0.0, 90.0, 100.0, 110.0)
    assert altitude_of(behind, spread_of(behind, ranges), ranges) > 0.0
    ranges = np.array([50.0, math.nan, 0.1, 50.0])
    assert math.isnan(altitude_of(behind, spread_of(behind, ranges), ranges))
