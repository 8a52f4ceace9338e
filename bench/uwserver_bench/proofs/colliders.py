"""Contacts in closed form, for tests of the solver without a collision engine: a plane under points of a body, and balls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from uwserver.frames import Vec3, rotate
from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.kernel.arrays import FloatArray


@dataclass(frozen=True)
class Floor:
    """A plane that touches bodies only at given points of them.

    Attributes:
        points: points of each body row, in B, m.
        normal: normal of the plane in N, towards the water.
        origin: a point of the plane.
        margin: contacts farther apart than this are left out, m.
    """

    points: Mapping[int, tuple[Vec3, ...]]
    normal: Vec3 = (0.0, 0.0, -1.0)
    origin: Vec3 = (0.0, 0.0, 0.0)
    friction: float = 0.0
    restitution: float = 0.0
    margin: float = 0.05

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """Return the contacts of the points that are near the plane. `dt` is not used."""
        rows, points, gaps, keys = [], [], [], []
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        for row, arms in self.points.items():
            for k, arm in enumerate(arms):
                point = state[row, :3] + np.array(rotate(tuple(state[row, 3:7]), arm))
                gap = float((point - self.origin) @ normal)
                if gap < self.margin:
                    rows.append(row)
                    points.append(point)
                    gaps.append(gap)
                    keys.append(1000 * row + k)
        return _contacts(
            rows, [-1] * len(rows), points, [normal] * len(rows), gaps, keys, self.friction, self.restitution
        )


@dataclass(frozen=True)
class Balls:
    """Balls that are fixed to bodies, and may touch each other.

    Attributes:
        balls: centre in B and radius of each body row, m.
    """

    balls: Mapping[int, tuple[Vec3, float]]
    friction: float = 0.0
    restitution: float = 0.0
    margin: float = field(default=0.05)

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """Return the contacts of each pair that is near. `dt` is not used."""
        a, b, points, normals, gaps, keys = [], [], [], [], [], []
        rows = sorted(self.balls)
        centers = {r: state[r, :3] + np.array(rotate(tuple(state[r, 3:7]), self.balls[r][0])) for r in rows}
        for i, first in enumerate(rows):
            for second in rows[i + 1 :]:
                apart = centers[first] - centers[second]
                distance = float(np.linalg.norm(apart))
                gap = distance - self.balls[first][1] - self.balls[second][1]
                if gap < self.margin:
                    normal = apart / distance
                    a.append(first)
                    b.append(second)
                    points.append(centers[second] + (self.balls[second][1] + 0.5 * gap) * normal)
                    normals.append(normal)
                    gaps.append(gap)
                    keys.append(1000 * first + second)
        return _contacts(a, b, points, normals, gaps, keys, self.friction, self.restitution)


def _contacts(
    a: list[int], b: list[int], points: list[FloatArray], normals: list[FloatArray], gaps: list[float], keys: list[int],
    friction: float, restitution: float,
) -> Contacts:  # fmt: skip
    k = len(a)
    return Contacts(
        np.array(a, np.int64),
        np.array(b, np.int64),
        np.array(points).reshape(k, 3),
        np.array(normals).reshape(k, 3),
        np.array(gaps, float),
        np.array(keys, np.int64),
        np.full(k, friction),
        np.full(k, restitution),
    )
