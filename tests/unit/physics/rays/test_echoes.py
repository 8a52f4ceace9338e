"""Echoes over range: energy, spreading, absorption and bins; what comes back of an incident intensity; counts of a logarithmic scale."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import CELL
from uwserver.physics.rays.echoes import Ground, Pulse, backscatter, compress, intensity
from uwserver.physics.rays.raycast import NOTHING, SURFACE, Hits

MU = np.array([0.1, 0.02])
GROUND = Ground(MU, 0.5)


def hits_of(distance: Any, normal: Any, body: Any = None, material: Any = None) -> Hits:
    distance = np.atleast_1d(np.array(distance, float))
    n = len(distance)
    normals = np.broadcast_to(np.array(normal, float), (n, 3)).copy()
    body = np.zeros(n, np.int64) if body is None else np.array(body)
    return Hits(distance, normals, body, np.zeros(n, np.int64) if material is None else np.array(material))


def ray(emitted: float = 1.0, width: float = 0.0) -> Any:
    """One ray ahead, of a cell of a width (rad)."""
    cells = np.zeros(1, CELL)
    cells["direction"], cells["emitted"] = (1.0, 0.0, 0.0), emitted
    cells["across"], cells["along"] = (0.0, width, 0.0), (0.0, 0.0, width)
    return cells


def echo(
    hits: Hits, cells: Any = None, bins: int = 200, per_metre: float = 10.0, resolution: float = 0.1, alpha: float = 0.0
) -> FloatArray:
    out = np.full(bins, np.nan)
    intensity(ray() if cells is None else cells, np.eye(3), hits, GROUND, Pulse(per_metre, resolution, alpha), out)
    return out


# -- intensity ------------------------------------------------------------------------------------------------------------------------


def test_an_echo_is_in_the_bin_of_its_range() -> None:
    out = echo(hits_of(7.23, (-1.0, 0.0, 0.0)))
    assert np.argmax(out) == 72
    assert out[[60, 90]].max() < 1e-12 * out.max()


@pytest.mark.parametrize("r", [2.05, 5.05, 15.05])
def test_a_perpendicular_echo_falls_with_the_fourth_power_and_grows_with_the_solid_angle(r: float) -> None:
    """mu cos^2 on r^2 dOmega / cos, twice r^-2 of spreading: mu dOmega / r^2 for each cell of the pulse."""
    for emitted in (1.0, 3.0):
        total = echo(hits_of(r, (-1.0, 0.0, 0.0)), ray(emitted)).sum()
        assert total == pytest.approx(emitted * 0.1 / r**2, rel=1e-2)


def test_lambert_s_law_and_the_grazing_area_leave_one_cosine() -> None:
    normal = (-math.cos(0.7), 0.0, -math.sin(0.7))
    ratio = echo(hits_of(5.05, normal)).sum() / echo(hits_of(5.05, (-1.0, 0.0, 0.0))).sum()
    assert ratio == pytest.approx(math.cos(0.7), rel=1e-2)


def test_the_attitude_of_the_fan_counts_and_not_the_frame() -> None:
    c, s = math.cos(0.4), math.sin(0.4)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    level, turned = np.empty(200), np.empty(200)
    normal = np.array([-0.8, 0.6, 0.0])
    intensity(ray(width=0.1), np.eye(3), hits_of(5.0, normal), GROUND, Pulse(10.0, 0.1, 0.0), level)
    intensity(ray(width=0.1), R, hits_of(5.0, R @ normal), GROUND, Pulse(10.0, 0.1, 0.0), turned)
    np.testing.assert_allclose(turned, level, rtol=1e-9, atol=1e-18)


def test_absorption_is_there_and_back() -> None:
    lossy, clear = (echo(hits_of(5.05, (-1.0, 0.0, 0.0)), alpha=alpha).sum() for alpha in (0.3, 0.0))
    assert 10.0 * math.log10(clear / lossy) == pytest.approx(2.0 * 0.3 * 5.05, abs=0.01)


def test_a_wide_ray_at_grazing_incidence_covers_an_interval_with_the_same_energy() -> None:
    normal = (-math.cos(1.3), 0.0, -math.sin(1.3))
    narrow, wide = (echo(hits_of(10.0, normal), ray(width=width)) for width in (0.0, 0.05))
    q = 0.5 * 0.05 * math.sin(1.3) / math.cos(1.3)
    covered = np.flatnonzero(wide > 1e-6 * wide.max())
    assert covered[0] == pytest.approx(100.0 / (1.0 + q), abs=2.0)
    assert covered[-1] == pytest.approx(100.0 / (1.0 - q), abs=2.0)
    r = (np.arange(200) + 0.5) / 10.0
    assert (wide * r**5).sum() == pytest.approx((narrow * r**5).sum() / (1.0 - q * q), rel=0.04)


def test_rays_add_up_and_misses_add_nothing() -> None:
    cells = np.concatenate([ray(), ray(2.0), ray()])
    both = echo(hits_of([4.05, 9.05, 3.0], (-1.0, 0.0, 0.0), body=[0, 0, NOTHING]), cells)
    alone = echo(hits_of(4.05, (-1.0, 0.0, 0.0))) + echo(hits_of(9.05, (-1.0, 0.0, 0.0)), ray(2.0))
    np.testing.assert_allclose(both, alone, rtol=0.0, atol=1e-9 * alone.max())
    assert not echo(hits_of(3.0, (-1.0, 0.0, 0.0), body=[NOTHING])).any()


def test_what_lies_behind_the_last_bin_is_lost() -> None:
    assert echo(hits_of(25.0, (-1.0, 0.0, 0.0))).max() < 1e-15
    edge = echo(hits_of(20.0, (-1.0, 0.0, 0.0)), resolution=1.0)
    assert np.isfinite(edge).all()
    assert edge[-1] > 0.0


def test_a_hit_at_no_distance_is_finite() -> None:
    assert np.isfinite(echo(hits_of(0.0, (-1.0, 0.0, 0.0)))).all()


@pytest.mark.parametrize(
    ("body", "material", "mu"), [(0, 0, 0.1), (0, 1, 0.02), (0, 9, 0.02), (0, -3, 0.1), (SURFACE, SURFACE, 0.5)]
)
def test_each_material_scatters_by_its_own_and_an_unknown_one_by_the_last(body: int, material: int, mu: float) -> None:
    plain = echo(hits_of(5.0, (-1.0, 0.0, 0.0))).sum()
    assert echo(hits_of(5.0, (-1.0, 0.0, 0.0), [body], [material])).sum() == pytest.approx(plain * mu / 0.1)


# -- backscatter ----------------------------------------------------------------------------------------------------------------------


def test_backscatter_is_lambert_s_law() -> None:
    angles = np.array([0.1, 0.8, math.pi / 2])
    direction = np.stack([np.cos(angles), np.zeros(3), np.sin(angles)], axis=1)
    hits, out = hits_of([5.0] * 3, (0.0, 0.0, -1.0), material=[0, 1, 0]), np.empty(3)
    backscatter(direction, hits.normal, hits.body, hits.material, *GROUND, out)
    np.testing.assert_allclose(out, [0.1, 0.02, 0.1] * np.sin(angles) ** 2)


def test_no_bottom_is_so_flat_that_nothing_comes_back_and_a_miss_is() -> None:
    direction = np.array([[1.0, 0.0, 0.0]] * 2)
    hits, out = hits_of([5.0] * 2, (0.0, 0.0, -1.0), body=[0, NOTHING]), np.empty(2)
    backscatter(direction, hits.normal, hits.body, hits.material, *GROUND, out)
    assert out.tolist() == pytest.approx([0.1 * 1e-4, 0.0])


# -- counts ---------------------------------------------------------------------------------------------------------------------------


def counts_of(level_db: Any, **changes: float) -> list[int]:
    """Counts of levels in dB, of bins 1 m long without any gain unless it is given; 2 counts a dB."""
    numbers = {
        "spacing": 1.0,
        "spreading": 0.0,
        "alpha": 0.0,
        "limit": 200.0,
        "offset": 0.0,
        "steps": 2.0,
        "full": 255.0,
    } | changes
    levels = 10.0 ** (0.1 * np.array(level_db, float))
    out = np.empty(len(levels), np.int64)
    compress(levels, *numbers.values(), out)
    return out.tolist()


def test_counts_are_steps_a_decibel_between_nothing_and_full() -> None:
    assert counts_of([-10.0, 0.0, 10.0, 50.2, 500.0]) == [0, 0, 20, 100, 255]
    assert counts_of([-10.0, 0.0, 10.0], offset=15.0) == [10, 30, 50]


def test_silence_is_no_error() -> None:
    out = np.empty(2, np.int64)
    compress(np.zeros(2), 1.0, 30.0, 0.1, 60.0, 100.0, 1.0, 255.0, out)
    assert out.tolist() == [0, 0]


def test_gain_makes_up_for_spreading_and_absorption_up_to_its_limit() -> None:
    r = np.arange(100) + 0.5
    levels = 100.0 - 30.0 * np.log10(r) - 2.0 * 0.2 * r
    assert set(counts_of(levels, spreading=30.0, alpha=0.2)) == {200}
    limited = counts_of(levels, spreading=30.0, alpha=0.2, limit=40.0)
    assert limited[0] == 200
    assert limited[-1] < 150
