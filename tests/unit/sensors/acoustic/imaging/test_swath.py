"""Rays and beams of a swath, and mirrors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.physics.rays.raycast import Hits
from uwserver.sensors.acoustic.imaging.swath import Swath, reflected, unfolded

DEG = math.pi / 180.0


def test_columns_fill_the_field_and_a_margin_and_beams_the_field() -> None:
    swath = Swath(60 * DEG, 1 * DEG, 20 * DEG, 120, 40)
    assert swath.columns % 4 == 0
    assert swath.columns >= 2 * 64
    assert swath.grid.azimuth[-1] == pytest.approx(32 * DEG, abs=1 * DEG)
    assert swath.azimuth[0] == pytest.approx(-29.75 * DEG)
    assert swath.pattern.shape == swath.power.shape == (120, swath.columns)
    assert np.array_equal(swath.column, np.arange(swath.columns * 40) % swath.columns)
    emitted = swath.grid.cells["emitted"].reshape(40, swath.columns)
    assert emitted[:, 0].max() < 0.05 * emitted[:, swath.columns // 2].max()  # the transmitter fades beside the field


def test_a_wide_field_ends_before_the_back() -> None:
    swath = Swath(170 * DEG, 10 * DEG, 20 * DEG, 16, 8)
    assert np.abs(swath.grid.azimuth).max() < 0.5 * math.pi


def test_a_mirror_shows_what_is_behind_it() -> None:
    """A wall 10 m ahead, seen by way of a level surface 3 m above: as far as its image, and as steep."""
    hits = Hits(np.array([5.0]), np.array([[0.0, 0.0, 1.0]]), np.array([-2]), np.array([-2]))
    d = np.array([[0.8, 0.0, -0.6]])
    start, towards = reflected(hits, np.array([0]), np.zeros(3), d)
    assert np.allclose(start, [[4.0, 0.0, -2.999]])
    assert np.allclose(towards, [[0.8, 0.0, 0.6]])
    tilted = np.array([[-0.8, 0.0, 0.6]])
    seen = unfolded(hits, np.array([0]), Hits(np.array([7.5]), tilted, np.array([4]), np.array([1])))
    assert seen.distance[0] == 12.5
    assert np.allclose(seen.normal, [[-0.8, 0.0, -0.6]])
    assert (seen.body[0], seen.material[0]) == (4, 1)
