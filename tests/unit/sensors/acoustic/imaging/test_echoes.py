"""Echoes over range: energy, spreading, absorption and gates."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.echoes import Ground
from uwserver.physics.rays.raycast import NOTHING, SURFACE, Hits
from uwserver.sensors.acoustic.imaging.echoes import MOST_GATES, deposit, energies, gates
from uwserver.sensors.acoustic.imaging.fan import CELL

GROUND = Ground(np.array([0.1, 0.02]), 0.5)
AHEAD = np.array([[1.0, 0.0, 0.0]])


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
    hits: Hits, cells: Any = None, count: int = 200, per_metre: float = 10.0, alpha: float = 0.0, R: Any = None, rays: Any = None
) -> FloatArray:  # fmt: skip
    """Energies of gates, of rays ahead through the middles of their cells unless they are given."""
    cells, R, out, second = (
        ray() if cells is None else cells,
        np.eye(3) if R is None else R,
        np.empty(count),
        np.zeros(count + 3),
    )
    direction = np.ascontiguousarray(cells["direction"] @ R.T) if rays is None else np.array(rays, float)
    deposit(cells, direction, R, *hits, GROUND, per_metre, np.zeros(len(cells), np.int64), 0.0, 1.0, second[None])
    energies(second, per_metre, alpha, out)
    return out


def test_an_echo_is_in_the_gate_of_its_range() -> None:
    out = echo(hits_of(7.23, (-1.0, 0.0, 0.0)))
    assert np.argmax(out) == 72
    assert out[[60, 90]].max() < 1e-12 * out.max()


@pytest.mark.parametrize("r", [2.05, 5.05, 15.05])
def test_a_perpendicular_echo_falls_with_the_fourth_power_and_grows_with_the_solid_angle(r: float) -> None:
    """mu cos^2 on r^2 dOmega / cos, twice r^-2 of spreading: mu dOmega / r^2 in all."""
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
    normal = np.array([-0.8, 0.6, 0.0])
    level, turned = echo(hits_of(5.0, normal), ray(width=0.1)), echo(hits_of(5.0, R @ normal), ray(width=0.1), R=R)
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


def test_what_lies_behind_the_last_gate_is_lost() -> None:
    assert not echo(hits_of(25.0, (-1.0, 0.0, 0.0))).any()
    edge = echo(hits_of(19.999, (-1.0, 0.0, 0.0)))
    assert edge[-1] > 0.0
    assert np.isfinite(edge).all()


def test_what_a_ray_beside_the_middle_meets_is_continued_to_the_middle_of_its_cell() -> None:
    """A flat bottom, 12 degrees below the beam: a ray at the edge of the cell leaves what one in the middle does."""
    cells, down = ray(width=0.02), np.array([0.0, 0.0, -1.0])
    dip = 0.2
    for key, vector in (
        ("direction", (math.cos(dip), 0.0, math.sin(dip))),
        ("along", (-0.02 * math.sin(dip), 0.0, 0.02 * math.cos(dip))),
    ):
        cells[key] = vector
    middle = echo(hits_of(2.0 / math.sin(dip), down), cells)
    steep = dip + 0.009
    edge = echo(hits_of(2.0 / math.sin(steep), down), cells, rays=[(math.cos(steep), 0.0, math.sin(steep))])
    np.testing.assert_allclose(edge, middle, rtol=1e-9, atol=1e-12 * middle.max())
    assert not np.allclose(echo(hits_of(2.0 / math.sin(steep), down), cells), middle, rtol=1e-2)


@pytest.mark.parametrize(
    ("reach", "bins", "resolution"), [(30.0, 150, 0.0075), (30.0, 400, 0.0075), (10.0, 2000, 0.0075), (10.0, 1200, 0.04), (1.0, 4096, 5.0)]
)  # fmt: skip
def test_bins_are_of_whole_gates_and_a_pulse_of_two_or_more(reach: float, bins: int, resolution: float) -> None:
    made = gates(reach, bins, resolution)
    assert made.window >= 2.0
    assert made.window / made.per_metre == pytest.approx(min(resolution, reach))
    assert made.per_bin / made.per_metre == pytest.approx(reach / bins)
    # No more looks than two in a pulse, but one a bin.
    assert made.per_bin == 1 or made.window < 2.0 + 2.0 / (made.per_bin - 1)
    assert made.total >= bins * made.per_bin + 0.5 * made.window


def test_a_device_that_believes_a_wrong_sound_speed_stretches_its_gates() -> None:
    made = gates(30.0, 300, 0.01, 1.1)
    assert made.window / made.per_metre == pytest.approx(0.01)
    assert made.per_bin / made.per_metre == pytest.approx(0.1 / 1.1)


@pytest.mark.parametrize("bins", [8, 4096])
def test_a_pulse_too_short_for_so_long_a_range_counts_as_longer(bins: int) -> None:
    made = gates(1e6, bins, 1e-6)
    assert made.total < MOST_GATES + bins
    assert made.window == 2.0


def test_a_hit_at_no_distance_is_finite() -> None:
    assert np.isfinite(echo(hits_of(0.0, (-1.0, 0.0, 0.0)))).all()


@pytest.mark.parametrize(
    ("body", "material", "mu"), [(0, 0, 0.1), (0, 1, 0.02), (0, 9, 0.02), (0, -3, 0.1), (SURFACE, SURFACE, 0.5)]
)
def test_each_material_scatters_by_its_own_and_an_unknown_one_by_the_last(body: int, material: int, mu: float) -> None:
    plain = echo(hits_of(5.0, (-1.0, 0.0, 0.0))).sum()
    assert echo(hits_of(5.0, (-1.0, 0.0, 0.0), [body], [material])).sum() == pytest.approx(plain * mu / 0.1)
