"""Planes and spheres in closed form, as exact solids for tests of ranging sensors without an engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import Hits, no_hits

Vec3 = tuple[float, float, float]


@dataclass(frozen=True)
class Plane:
    """All points p in N with normal . (p - point) = 0. It is solid below, so only rays against the normal hit it."""

    point: Vec3
    normal: Vec3

    def hit(self, origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances (n), inf without a hit, and normals (n, 3)."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        approach = direction @ normal
        height = (origin - self.point) @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where((approach < 0.0) & (height >= 0.0), -height / approach, np.inf)
        return distance, np.broadcast_to(normal, origin.shape)


@dataclass(frozen=True)
class Sphere:
    """A solid ball in N. Rays that start inside do not hit it."""

    center: Vec3
    radius: float

    def hit(self, origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances (n), inf without a hit, and normals (n, 3)."""
        to_center = origin - np.array(self.center)
        b = np.einsum("ij,ij->i", to_center, direction)
        c = np.einsum("ij,ij->i", to_center, to_center) - self.radius**2
        discriminant = b * b - c
        near = -b - np.sqrt(np.maximum(discriminant, 0.0))
        distance = np.where((discriminant >= 0.0) & (near >= 0.0) & (c >= 0.0), near, np.inf)
        reached = np.where(np.isfinite(distance), distance, 0.0)
        return distance, (to_center + reached[:, None] * direction) / self.radius


class FakeGeometry:
    """A `uwserver.physics.rays.raycast.Geometry` of analytic shapes.

    Args:
        shapes: the shapes; the id of a shape is its index.
        materials: number of the material of each shape; default 0.
    """

    def __init__(self, shapes: Sequence[Plane | Sphere], materials: Sequence[int] = ()) -> None:
        self._shapes = tuple(shapes)
        self._materials = tuple(materials) or (0,) * len(self._shapes)

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Return the nearest shape that each ray hits."""
        best, normal, body, material = no_hits(len(origin))
        for k, shape in enumerate(self._shapes):
            distance, normals = shape.hit(origin, direction)
            nearer = (distance < best) & (distance <= max_range)
            best = np.where(nearer, distance, best)
            normal = np.where(nearer[:, None], normals, normal)
            body = np.where(nearer, k, body)
            material = np.where(nearer, self._materials[k], material)
        return Hits(best, normal, body, material)
