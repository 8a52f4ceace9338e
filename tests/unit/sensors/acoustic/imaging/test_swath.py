"""Rays and beams of swaths, also to both sides of a vehicle, and mirrors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.physics.rays.raycast import Hits
from uwserver.sensors.acoustic.imaging.fan import COLUMNS, Sides, Swath, depressions, reflected, two_way, unfolded

DEG = math.pi / 180.0
WIDTH, HEIGHT, TILT = math.radians(1.0), math.radians(50.0), math.radians(20.0)
SIDES = Sides(WIDTH, HEIGHT, TILT, 200)
PORT = SIDES.column < COLUMNS


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


def test_rows_go_on_in_equal_parts_of_the_distance() -> None:
    edges = depressions(400)
    assert np.all(np.diff(edges) > 0.0)
    assert edges[100] == 0.0
    ratio = np.diff(np.log(np.tan(edges[edges > math.radians(10.0)])))
    assert ratio.max() < 1.02 * ratio.min()


def test_port_is_starboard_in_a_mirror() -> None:
    for rays in (
        SIDES.grid.direction,
        SIDES.grid.cells["direction"],
        SIDES.grid.cells["along"],
        SIDES.grid.cells["across"],
    ):
        assert np.allclose(rays[PORT], rays[~PORT] * (1.0, -1.0, 1.0), atol=1e-15)
    assert np.all(SIDES.grid.direction[PORT, 1] <= 0.01)
    assert np.array_equal(SIDES.grid.cells["emitted"][PORT], SIDES.grid.cells["emitted"][~PORT])
    assert not SIDES.pattern[0, COLUMNS:].any()
    assert not SIDES.pattern[1, :COLUMNS].any()


def test_rays_are_of_length_one_and_in_their_cells() -> None:
    assert np.allclose(np.linalg.norm(SIDES.grid.direction, axis=1), 1.0)
    cells = SIDES.grid.cells
    off = SIDES.grid.direction - cells["direction"]
    for edge in ("across", "along"):
        size = np.linalg.norm(cells[edge], axis=1)
        assert np.all(np.abs(np.einsum("ij,ij->i", off, cells[edge]) / size) <= 0.51 * size)


def test_cells_make_up_the_pattern() -> None:
    """Of one side: the two-way pattern over all that the rays fill."""
    d, a = np.linspace(-math.radians(80.0), math.radians(89.5), 20_001), np.linspace(-WIDTH, WIDTH, 2001)
    whole = two_way(d - TILT, HEIGHT).mean() * (d[-1] - d[0]) * two_way(a, WIDTH).mean() * (a[-1] - a[0])
    column = SIDES.column[~PORT]
    heard = (SIDES.grid.cells["emitted"][~PORT] * SIDES.power[1, column]).sum()
    assert heard == pytest.approx(whole, rel=0.01)
