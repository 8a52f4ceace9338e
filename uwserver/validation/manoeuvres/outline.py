"""Points on the surface of a vehicle's shapes, for its size and its picture."""

from __future__ import annotations

import itertools

import numpy as np

from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Shape, Solid, Sphere
from uwserver.physics.kernel.arrays import FloatArray

_AROUND, _ALONG = 36, 13


def outline(solid: Solid) -> list[FloatArray]:
    """Return points (n, 3) for each shape, in the frame of the solid, m. Their convex hull is nearly the shape's."""
    return [np.array(part.p) + _points(part.shape) @ part.R.T for part in solid.shapes]


def _points(shape: Shape) -> FloatArray:
    if isinstance(shape, Box):
        return np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * shape.half
    if isinstance(shape, Sphere):
        return _ball(shape.radius)
    if isinstance(shape, Cylinder | Capsule):
        end = _ring(shape.radius, 0.0) if isinstance(shape, Cylinder) else _ball(shape.radius)
        return np.concatenate([end + np.array([x, 0.0, 0.0]) for x in (-shape.half_length, shape.half_length)])
    if isinstance(shape, ConvexHull):
        return shape.points
    raise TypeError(f"a vehicle has no {type(shape).__name__}")


def _ring(radius: float, x: float) -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
    return np.stack([np.full_like(angle, x), radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _ball(radius: float) -> FloatArray:
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ALONG)
    return np.concatenate([_ring(radius * float(np.cos(a)), radius * float(np.sin(a))) for a in latitude])
