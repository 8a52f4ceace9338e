"""How far a contact goes within a tick (compiled).

Where a ball rolls, its contact goes with its centre; a corner that stands stays in its place; between two edges it goes as neither does. The
way that the same contact went in the last tick tells all these apart, to second order in the tick.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.physics.contact.solver import Constraints
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.rotation import rotation

_FASTEST = 1.5
"""A contact that went farther than this times the way of the bodies' surfaces is another, or its bodies were put elsewhere."""


@compiled
def set_drift(
    contacts: Any, constraints: Constraints, start: Array, old_key: Array, old_point: Array, dt: float, R: Array, drift: Array
) -> None:  # fmt: skip
    """Displacements (k, 3) of contacts in N within the tick, m.

    A contact that was not there in the tick before goes as the bodies' origins do, in the mean: right for what is round.

    Args:
        contacts: of the start of the tick.
        constraints: tell the places of their bodies.
        start: (m, 13) states at the start, after the hits.
        old_key, old_point: (j), (j, 3) of the contacts of the tick before.
        dt: s.
        R: (3, 3) work space.
        drift: out.
    """
    m, old = start.shape[0], old_key.shape[0]
    way = np.empty((m, 4))  # of the origin, and the angle
    for i in range(m):
        x = start[i]
        rotation(x[3], x[4], x[5], x[6], R)
        for j in range(3):
            way[i, j] = dt * (R[j, 0] * x[7] + R[j, 1] * x[8] + R[j, 2] * x[9])
        way[i, 3] = dt * math.sqrt(x[10] * x[10] + x[11] * x[11] + x[12] * x[12])
    for c in range(drift.shape[0]):
        a, b, point = constraints.slot_a[c], constraints.slot_b[c], contacts.point[c]
        part = 0.5 if b >= 0 else 1.0
        for i in range(3):
            drift[c, i] = part * (way[a, i] + (way[b, i] if b >= 0 else 0.0))
        for j in range(old):
            o = (c + j) % old  # the order seldom changes
            if old_key[o] == contacts.key[c]:
                x, y, z = point[0] - old_point[o, 0], point[1] - old_point[o, 1], point[2] - old_point[o, 2]
                most = _surface_way(start[a], way[a], point)
                if b >= 0:
                    most += _surface_way(start[b], way[b], point)
                if math.sqrt(x * x + y * y + z * z) <= _FASTEST * most:
                    drift[c, 0], drift[c, 1], drift[c, 2] = x, y, z
                break


@compiled
def _surface_way(x: Array, way: Array, point: Array) -> float:
    """How far (m) a point of a body can go within the tick, at most."""
    dx, dy, dz = point[0] - x[0], point[1] - x[1], point[2] - x[2]
    along = math.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    return along + float(way[3]) * math.sqrt(dx * dx + dy * dy + dz * dz)
