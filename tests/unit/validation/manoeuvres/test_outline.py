"""Points of shapes lie on them and reach to their ends, wherever the shape is put."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, HalfSpace, Placed, Shape, Solid, Sphere
from uwserver.validation.manoeuvres.outline import outline


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (Box((0.5, 0.2, 0.1)), (1.0, 0.4, 0.2)),
        (Sphere(0.3), (0.6, 0.6, 0.6)),
        (Cylinder(0.2, 0.5), (1.0, 0.4, 0.4)),
        (Capsule(0.2, 0.5), (1.4, 0.4, 0.4)),
        (ConvexHull(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])), (1.0, 1.0, 1.0)),
    ],
)  # fmt: skip
def test_the_size_of_each_shape(shape: Shape, size: tuple[float, float, float]) -> None:
    (points,) = outline(Solid("one", (Placed(shape),)))
    assert np.ptp(points, axis=0) == pytest.approx(size, rel=1e-6)


def test_a_shape_is_where_it_is_put() -> None:
    placed = Placed(Cylinder(0.2, 0.5), (1.0, 2.0, 3.0), quat_from_rpy(0.0, 0.0, math.pi / 2.0))
    (points,) = outline(Solid("one", (placed,)))
    assert points.mean(axis=0) == pytest.approx((1.0, 2.0, 3.0))
    assert np.ptp(points, axis=0) == pytest.approx((0.4, 1.0, 0.4), rel=1e-6)


def test_no_vehicle_is_a_seabed() -> None:
    with pytest.raises(TypeError, match="HalfSpace"):
        outline(Solid("one", (Placed(HalfSpace()),)))
