"""Volumes cut by a plane: symmetry, additions and limits; brute force over points where no formula is at hand.

`tests/physics/test_immersion.py` has the closed forms of boxes and spheres, and what bodies do with them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwserver.physics.dynamics.immersion import (
    box_fraction,
    depth_below,
    disc_fraction,
    immersion,
    sphere_fraction,
    upward,
)
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import (
    BODY,
    FLOW_KIND,
    FLOW_PLANE,
    FLOW_SIZE,
    FLOW_T,
    SHAPE,
    SHAPE_BOX,
    SHAPE_SPHERE,
    STEADY,
    WAVY,
)

HALF = np.array([0.5, 0.3, 0.2])


def unit(*v: float) -> FloatArray:
    result: FloatArray = np.array(v) / np.linalg.norm(v)
    return result


UPS = [unit(0.0, 0.0, -1.0), unit(0.3, -0.2, -1.0), unit(1.0, 1.0, 1.0), unit(-1.0, 0.1, 0.0)]


def below(up: FloatArray, depth: float, n: int = 60) -> tuple[float, FloatArray]:
    """Fraction of the box below the plane, and its centre, by counting points of a grid."""
    axes = [half * (2.0 * np.arange(n) + 1.0 - n) / n for half in HALF]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    wet = points[points @ up < depth]
    return len(wet) / len(points), wet.mean(axis=0) if len(wet) else np.zeros(3)


@pytest.mark.parametrize("depth", [-0.15, -0.02, 0.0, 0.1])
@pytest.mark.parametrize("up", UPS)
def test_a_cut_box_against_counted_points(up: FloatArray, depth: float) -> None:
    offset = np.empty(3)
    fraction = box_fraction(depth, HALF, up, offset)
    counted, centre = below(up, depth)
    assert fraction == pytest.approx(counted, abs=0.01)
    np.testing.assert_allclose(offset, centre, rtol=0.0, atol=0.01)


@pytest.mark.parametrize("depth", [-0.15, 0.0, 0.07])
@pytest.mark.parametrize("up", UPS)
def test_both_sides_of_a_cut_are_the_whole_box(up: FloatArray, depth: float) -> None:
    """Fractions add up to one, and the two centres balance about the middle."""
    wet, dry = np.empty(3), np.empty(3)
    a, b = box_fraction(depth, HALF, up, wet), box_fraction(-depth, HALF, -up, dry)
    assert a + b == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(a * wet + b * dry, 0.0, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("depth", [-0.19, 0.0, 0.05])
def test_both_sides_of_a_cut_are_the_whole_sphere(depth: float) -> None:
    wet, dry, up = np.empty(3), np.empty(3), UPS[1]
    a, b = sphere_fraction(depth, 0.2, up, wet), sphere_fraction(-depth, 0.2, -up, dry)
    assert a + b == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(a * wet + b * dry, 0.0, rtol=0.0, atol=1e-15)
    assert wet @ up < 0.0 < dry @ up


@pytest.mark.parametrize(("depth", "fraction"), [(9.0, 1.0), (0.2, 1.0), (-0.2, 0.0), (-9.0, 0.0)])
def test_all_or_nothing_is_centred(depth: float, fraction: float) -> None:
    offset = np.full(3, 7.0)
    up = UPS[0]
    for found in (box_fraction(depth, HALF, up, offset), sphere_fraction(depth, 0.2, up, offset)):
        assert found == fraction
        np.testing.assert_array_equal(offset, 0.0)
    assert disc_fraction(depth, 0.2) == fraction


def test_a_box_that_dips_in_by_a_hair_has_a_centre_within_it() -> None:
    for dip in (1e-3, 1e-6, 1e-9, 1e-13):
        offset = np.empty(3)
        reach = float(np.abs(UPS[1]) @ HALF)
        fraction = box_fraction(-reach + dip, HALF, UPS[1], offset)
        assert 0.0 <= fraction < 1e-2
        assert (np.abs(offset) <= HALF + 1e-12).all()


def test_a_disc_is_a_circle_s_segment() -> None:
    points = np.linspace(-1.0, 1.0, 200_001)
    width = np.sqrt(1.0 - points**2)
    for depth in (-0.7, 0.0, 0.3):
        assert disc_fraction(0.1 * depth, 0.1) == pytest.approx(width[points < depth].sum() / width.sum(), abs=1e-4)


def tilted(kind: float = WAVY) -> FloatArray:
    """A surface that rises by 0.2 along x, is 0.1 high at the origin at 3 s and rises by 0.5 m/s."""
    flow = np.zeros(FLOW_SIZE)
    flow[FLOW_PLANE : FLOW_PLANE + 4] = 0.1, 0.2, 0.0, 0.5
    flow[FLOW_T], flow[FLOW_KIND] = 3.0, kind
    return flow


def test_depth_is_the_distance_from_the_plane() -> None:
    norm = np.sqrt(1.04)
    assert depth_below(tilted(), 0.0, 0.0, 2.0, 3.0) == pytest.approx(2.1 / norm)
    assert depth_below(tilted(), 1.0, 7.0, 2.0, 3.0) == pytest.approx(2.3 / norm)
    assert depth_below(tilted(), 0.0, 0.0, 2.0, 3.2) == pytest.approx(2.2 / norm)
    assert depth_below(tilted(STEADY), 5.0, 5.0, 2.0, 9.0) == 2.0


def test_up_is_square_to_the_plane_and_given_in_b() -> None:
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    up = np.empty(3)
    upward(tilted(), R, up)
    np.testing.assert_allclose(R @ up, unit(-0.2, 0.0, -1.0), rtol=0.0, atol=1e-15)
    upward(tilted(STEADY), R, up)
    np.testing.assert_allclose(R @ up, [0.0, 0.0, -1.0], rtol=0.0, atol=1e-15)


def body_of(*shapes: tuple[int, Any, Any, float]) -> tuple[Any, Any]:
    rows, body = np.zeros(len(shapes) + 1, SHAPE), np.zeros(1, BODY)
    for row, shape in zip(rows[1:], shapes, strict=True):
        row["kind"], row["center"], row["half"], row["share"] = shape
    body["shape_first"], body["shape_count"], body["radius"], body["r_b"] = 1, len(shapes), 1.0, (0.0, 0.0, 0.3)
    return body[0], rows


def immersed(depth: float, *shapes: tuple[int, Any, Any, float]) -> tuple[float, FloatArray]:
    body, rows = body_of(*shapes)
    center, scratch = np.empty(3), np.zeros((2, 3))
    scratch[0] = 0.0, 0.0, -1.0
    return immersion(body, rows, depth, center, scratch), center


CUBE = (SHAPE_BOX, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1), 0.5)


def test_shapes_count_by_their_shares() -> None:
    """A cube half out of the water, and a ball far below."""
    fraction, center = immersed(0.0, CUBE, (SHAPE_SPHERE, (0.4, 0.0, 0.5), (0.1, 0.0, 0.0), 0.5))
    assert fraction == pytest.approx(0.75)
    np.testing.assert_allclose(center, (0.25 * np.array([0.0, 0.0, 0.05]) + 0.5 * np.array([0.4, 0.0, 0.5])) / 0.75)


def test_out_of_the_water_and_far_below_it() -> None:
    assert immersed(-0.5, CUBE)[0] == 0.0
    fraction, center = immersed(1.5, CUBE)
    assert fraction == 1.0
    np.testing.assert_array_equal(center, [0.0, 0.0, 0.3])


def test_a_body_without_shapes_is_always_submerged() -> None:
    fraction, center = immersed(-5.0)
    assert fraction == 1.0
    np.testing.assert_array_equal(center, [0.0, 0.0, 0.3])
