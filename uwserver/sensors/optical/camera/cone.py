"""Finds things outside the view of a camera without casting rays: by balls around things and a cone around all rays."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray

_PARTS = 6
"""Parts along each axis. A thing has at most this number to the third power of balls."""


class Balls(NamedTuple):
    """Balls around parts of a thing: centres (n, 3) and radii (n), m."""

    centre: FloatArray
    radius: FloatArray


def balls_of(corners: FloatArray) -> Balls:
    """Return balls that contain all triangles (n, 3, 3). Each ball contains the triangles of one place."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    middle = 0.5 * (low + high)
    first = middle.min(axis=0)
    place = ((middle - first) * (_PARTS / np.maximum(np.ptp(middle, axis=0), 1e-9))).astype(np.int64)
    keys = np.minimum(place, _PARTS - 1) @ np.array((1, _PARTS, _PARTS * _PARTS))
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    low, high = np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts)
    return Balls(0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1))


class Cone(NamedTuple):
    """A cone that contains rays that start near the origin.

    Attributes:
        axis: (3) unit vector.
        half: largest angle of a ray from the axis, rad.
        slack: largest distance of a start from the origin, m.
    """

    axis: FloatArray
    half: float
    slack: float

    def meets(self, balls: Balls) -> bool:
        """Return whether a ray may hit one of the balls."""
        far = np.linalg.norm(balls.centre, axis=1)
        radius = balls.radius + self.slack
        if bool((far <= radius).any()):
            return True
        turned = np.arccos(np.clip(balls.centre @ self.axis / far, -1.0, 1.0))
        return bool((turned <= self.half + np.arcsin(radius / far)).any())


def cone_of(direction: FloatArray, origin: FloatArray) -> Cone:
    """Return the cone about the x axis that contains rays: unit directions (n, 3) and origins (m, 3), m, in float32."""
    half = math.acos(max(min(float(direction[:, 0].min()), 1.0), -1.0))
    # 1e-3 covers the rounding of float32. Near the axis it is larger in the angle than in its cosine.
    return Cone(np.array((1.0, 0.0, 0.0)), half + 1e-3, float(np.linalg.norm(origin, axis=1).max()) + 1e-3)
