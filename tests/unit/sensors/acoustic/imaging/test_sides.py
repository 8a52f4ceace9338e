"""Rays of a side-scan sonar: their steps, their two sides, and the energy they stand for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.acoustic.imaging.fan import two_way
from uwserver.sensors.acoustic.imaging.sides import COLUMNS, Sides, depressions

WIDTH, HEIGHT, TILT = math.radians(1.0), math.radians(50.0), math.radians(20.0)
SIDES = Sides(WIDTH, HEIGHT, TILT, 200)
PORT = SIDES.column < COLUMNS


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
