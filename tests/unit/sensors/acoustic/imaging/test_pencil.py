"""Rays of a pencil beam."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.acoustic.imaging.fan import two_way
from uwserver.sensors.acoustic.imaging.pencil import Pencil

WIDTH = math.radians(1.5)


def test_rays_stand_for_the_pattern_whatever_their_number() -> None:
    x = np.linspace(-WIDTH, WIDTH, 4001)
    whole = (two_way(x, WIDTH).mean() * 2.0 * WIDTH) ** 2
    for side in (5, 9, 30):
        assert Pencil(WIDTH, side).grid.cells["emitted"].sum() == pytest.approx(whole, rel=0.01)


def test_rays_are_about_the_axis() -> None:
    pencil = Pencil(WIDTH, 9)
    assert pencil.grid.direction.shape == (81, 3)
    assert pencil.grid.direction.mean(axis=0)[1:] == pytest.approx((0.0, 0.0), abs=1e-3)
    assert np.degrees(np.arccos(pencil.grid.direction[:, 0])).max() < 2.2
    assert pencil.directivity == pytest.approx(4.0 * math.pi / WIDTH**2)
