"""The rays of one beam: solid angle and pattern of a fan, rays at different places in their cells, and a pencil beam."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate

from uwserver.sensors.acoustic.imaging.fan import FINEST, Fan, Pencil, directivity
from uwserver.sensors.acoustic.imaging.fan import two_way as pattern

WIDTH, HEIGHT = 0.05, 0.5
BEAM = math.radians(1.5)
"""Of a pencil."""


def two_way(angle: float, width: float) -> float:
    x = 2.0 * 1.391557 * angle / width
    return 1.0 if x == 0.0 else (math.sin(x) / x) ** 4


def test_a_fan_emits_what_the_pattern_does() -> None:
    """Over the sphere: cos of elevation in the solid angle."""
    fan = Fan(WIDTH, HEIGHT, 26, 142, 2.0, level=3.0)
    az = integrate.quad(two_way, -WIDTH, WIDTH, (WIDTH,))[0]
    el = integrate.quad(lambda a: two_way(a, HEIGHT) * math.cos(a), -HEIGHT, HEIGHT)[0]
    assert fan.cells["emitted"].sum() == pytest.approx(3.0 * az * el, rel=2e-3)


def test_cells_lie_about_their_middles_and_hold_the_solid_angle() -> None:
    fan = Fan(WIDTH, HEIGHT, 13, 71, 2.0)
    area = np.linalg.norm(np.cross(fan.cells["across"], fan.cells["along"]), axis=1)
    assert area == pytest.approx(np.repeat(fan.area, 13), rel=1e-4)
    assert np.einsum("ij,ij->i", fan.cells["across"], fan.cells["direction"]) == pytest.approx(0.0, abs=1e-15)


def test_tables_of_the_pattern_agree_with_the_cells() -> None:
    fan = Fan(WIDTH, HEIGHT, 3, 5, 2.0)
    for table, width, count in ((fan.across_power, WIDTH, 3), (fan.along_power, HEIGHT, 5)):
        angle = np.linspace(-width, width, 2 * FINEST * count + 1)
        assert table == pytest.approx([two_way(a, width) for a in angle], abs=1e-6)


@pytest.mark.parametrize(("columns", "rows"), [(13, 71), (1, 3), (3, 1), (26, 142), (256, 128)])
def test_rays_stay_in_their_cells_and_leave_no_gap_across_the_fan(columns: int, rows: int) -> None:
    """In each column there is a ray every cell / rows in azimuth, in each row one every cell / columns in elevation."""
    fan = Fan(WIDTH, HEIGHT, columns, rows, 2.0)
    place = fan.place.reshape(rows, columns, 2)
    assert np.array_equal(np.floor(place[0, :, 0]), np.arange(columns))
    assert np.array_equal(np.floor(place[:, 0, 1]), np.arange(rows))
    assert np.diff(np.sort(place[:, 0, 0])) == pytest.approx(1.0 / rows)
    assert np.diff(np.sort(place[0, :, 1] % 1.0)) == pytest.approx(1.0 / columns)
    az = np.arctan2(fan.direction[:, 1], fan.direction[:, 0])
    assert az == pytest.approx((fan.place[:, 0] - 0.5 * columns) * fan.size[0], abs=1e-12)
    assert np.arcsin(fan.direction[:, 2]) == pytest.approx((fan.place[:, 1] - 0.5 * rows) * fan.size[1], abs=1e-12)


def test_a_fan_that_is_not_staggered_has_its_rays_in_the_middle() -> None:
    fan = Fan(WIDTH, HEIGHT, 5, 7, 1.0, staggered=False)
    assert np.array_equal(fan.direction, fan.cells["direction"])


def test_directivity_is_that_of_the_aperture() -> None:
    assert directivity(0.1, 0.2) == pytest.approx(4.0 * math.pi / 0.02)


def test_rays_stand_for_the_pattern_whatever_their_number() -> None:
    x = np.linspace(-BEAM, BEAM, 4001)
    whole = (pattern(x, BEAM).mean() * 2.0 * BEAM) ** 2
    for side in (5, 9, 30):
        assert Pencil(BEAM, side).grid.cells["emitted"].sum() == pytest.approx(whole, rel=0.01)


def test_rays_are_about_the_axis() -> None:
    pencil = Pencil(BEAM, 9)
    assert pencil.grid.direction.shape == (81, 3)
    assert pencil.grid.direction.mean(axis=0)[1:] == pytest.approx((0.0, 0.0), abs=1e-3)
    assert np.degrees(np.arccos(pencil.grid.direction[:, 0])).max() < 2.2
    assert pencil.directivity == pytest.approx(4.0 * math.pi / BEAM**2)
