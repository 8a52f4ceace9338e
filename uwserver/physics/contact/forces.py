"""How contact impulses act on bodies within a tick, hits at once and holding impulses as a force, and how far a contact moves meanwhile (compiled).

Both kinds act on the two bodies of a contact at one point of N, with opposite signs. So they change neither the linear nor the angular momentum of
the two bodies together. A holding force is constant in the tick, and its point moves on with the contact.

The contact of a rolling ball moves with its centre, that of a corner that stands stays in its place, and that between two edges moves as neither of
them. The path of the same contact in the last tick tells these cases apart, to second order in the tick.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.contact.solver import Constraints
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import add_force, rotation

_FASTEST = 1.5
"""A contact that moved farther than this times the path of the bodies' surfaces is a different one, or its bodies were moved by other means."""


class Struck(NamedTuple):
    """What `step.strike` passes to `step.finish_contacts`, for k contacts of m bodies.

    Attributes:
        bodies: (m) rows of the bodies near a contact.
        M_inv: (m, 6, 6).
        constraints: constraints of the contacts.
        drift: (k, 3) displacement of each contact in N within the tick, m.
        hit: (k, 3) impulse at the start of the tick along the axes, N s.
        hold: (k, 3) impulse of the force over the tick, likewise.
        final: (k) whether nothing may be added at the end of the tick.
        change: (m, 6) of nu by all these impulses.
    """

    bodies: Array
    M_inv: Array
    constraints: Constraints
    drift: Array
    hit: Array
    hold: Array
    final: Array
    change: Array


@compiled
def apply_forces(
    rows: Array, bodies: Array, constraints: Constraints, point: Array, drift: Array, hold: Array, t: float, dt: float
) -> None:  # fmt: skip
    """Add impulses to the BODY rows as forces over the tick.

    Args:
        rows: rows of all bodies.
        bodies: (m) rows of those that the constraints name.
        constraints: constraints of k contacts.
        point: (k, 3) at the start of the tick, in N, m.
        drift, hold: as in `Struck`.
        t, dt: start and length of the tick, s.
    """
    for c in range(point.shape[0]):
        if hold[c, 0] <= 0.0:
            continue
        a, b, axes = constraints.slot_a[c], constraints.slot_b[c], constraints.axes[c]
        _add_force(rows[bodies[a]], point[c], drift[c], axes, hold[c], 1.0, t, dt)
        if b >= 0:
            _add_force(rows[bodies[b]], point[c], drift[c], axes, hold[c], -1.0, t, dt)


@compiled
def _add_force(
    body: Any, point: Array, drift: Array, axes: Array, impulse: Array, sign: float, t: float, dt: float
) -> None:
    """Add the force of one contact, and its moment, to a BODY row."""
    body.in_contact = 1
    wrench, scale = body.contact, sign / dt
    wrench[9] = t
    for d in range(3):
        size = scale * impulse[d]
        fx, fy, fz = size * axes[d, 0], size * axes[d, 1], size * axes[d, 2]
        add_force(wrench, point[0], point[1], point[2], fx, fy, fz)
        wrench[6] += (drift[1] * fz - drift[2] * fy) / dt
        wrench[7] += (drift[2] * fx - drift[0] * fz) / dt
        wrench[8] += (drift[0] * fy - drift[1] * fx) / dt


@compiled
def clear_contact(body: Any) -> None:
    """Remove the contact forces from a BODY row."""
    body.in_contact = 0
    for i in range(10):
        body.contact[i] = 0.0


@compiled
def set_drift(
    contacts: Any, constraints: Constraints, start: Array, old_key: Array, old_point: Array, dt: float, R: Array, drift: Array
) -> None:  # fmt: skip
    """Find the displacements (k, 3) of contacts in N within the tick, m.

    A contact that did not exist in the tick before moves as the mean of the bodies' origins, which is right for round bodies.

    Args:
        contacts: contacts of the start of the tick.
        constraints: their slots name the bodies.
        start: (m, 13) states at the start, after the hits.
        old_key, old_point: (j), (j, 3) of the contacts of the tick before.
        dt: s.
        R: (3, 3) work space.
        drift: out.
    """
    m, old = start.shape[0], old_key.shape[0]
    way = np.empty((m, 4))  # displacement of the origin, and angle of the turn
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
            o = (c + j) % old  # begins at the same place, as the order seldom changes
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
    """Return the longest distance (m) that a point of a body can move within the tick."""
    dx, dy, dz = point[0] - x[0], point[1] - x[1], point[2] - x[2]
    along = math.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    return along + float(way[3]) * math.sqrt(dx * dx + dy * dy + dz * dz)
