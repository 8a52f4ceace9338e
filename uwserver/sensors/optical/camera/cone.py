"""What a camera cannot see at all, found without rays: balls about things, and the cone of all that it sees."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray

_PARTS = 6
"""Along each axis: a thing is held by so many balls to the third power, or by fewer."""


class Balls(NamedTuple):
    """About parts of a thing: centres (n, 3) and radii (n), m."""

    centre: FloatArray
    radius: FloatArray


def balls_of(corners: FloatArray) -> Balls:
    """Some balls that hold all triangles (n, 3, 3), each those of one place."""
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
    """Of rays that start near the origin.

    Attributes:
        axis: (3) unit.
        half: no ray turns farther from it, rad.
        slack: nor starts farther from the origin, m.
    """

    axis: FloatArray
    half: float
    slack: float

    def meets(self, balls: Balls) -> bool:
        """Whether a ray may meet one of some balls."""
        far = np.linalg.norm(balls.centre, axis=1)
        radius = balls.radius + self.slack
        if bool((far <= radius).any()):
            return True
        turned = np.arccos(np.clip(balls.centre @ self.axis / far, -1.0, 1.0))
        return bool((turned <= self.half + np.arcsin(radius / far)).any())


def cone_of(direction: FloatArray, origin: FloatArray) -> Cone:
    """The cone about the x axis that holds rays: unit directions (n, 3) and origins (m, 3), m, of float32."""
    half = math.acos(max(min(float(direction[:, 0].min()), 1.0), -1.0))
    # Rounding of float32, which near the axis is more of an angle than of its cosine.
    return Cone(np.array((1.0, 0.0, 0.0)), half + 1e-3, float(np.linalg.norm(origin, axis=1).max()) + 1e-3)
