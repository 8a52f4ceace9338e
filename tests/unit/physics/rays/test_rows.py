"""Rows of what rays may hit."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, HalfSpace, Placed, Solid, Sphere
from uwserver.physics.geometry.tessellation import Facets, facets
from uwserver.physics.rays.rows import middle, planes, sides

BOX = facets(Solid("box", (Placed(Box((0.5, 0.3, 0.2)), (1.0, 2.0, 3.0), material=4),)))


def test_planes_are_those_of_half_spaces_with_the_outward_normal() -> None:
    slope = Placed(HalfSpace(), (0.0, 0.0, 10.0), quat_from_rpy(0.3, 0.0, 0.0))
    other = Placed(HalfSpace(), (1.0, 0.0, 0.0), material=5)
    found = planes([(3, Solid("a", (slope, Placed(Sphere(1.0))), material=2)), (8, Solid("b", (other,)))])
    assert found["body"].tolist() == [3, 8]
    assert found["material"].tolist() == [2, 5]
    np.testing.assert_array_equal(found["point"], [slope.p, other.p])
    np.testing.assert_allclose(found["normal"][0], -slope.R[:, 2], rtol=0.0, atol=1e-15)
    assert len(planes([])) == 0


def test_sides_stand_about_a_point_with_outward_unit_normals() -> None:
    rows = sides(BOX, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(rows["corners"] + [1.0, 2.0, 3.0], BOX.corners, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(rows["normal"], axis=1), 1.0)
    assert (np.einsum("ni,ni->n", rows["normal"], rows["corners"][:, 0]) > 0.0).all()
    assert set(rows["material"]) == {4}
    assert rows["sided"].all()


def test_a_triangle_without_area_has_no_normal() -> None:
    flat = Facets(np.zeros((1, 3, 3)), np.zeros(1, np.int64), np.ones(1, np.int64))
    assert not sides(flat, np.zeros(3))["normal"].any()


def test_the_middle_is_that_of_the_box_around_all() -> None:
    centre, half = middle(BOX)
    assert centre.tolist() == pytest.approx([1.0, 2.0, 3.0])
    assert half.tolist() == pytest.approx([0.5, 0.3, 0.2])
