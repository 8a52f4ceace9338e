"""How contact impulses act on bodies within a tick: hits at once, what holds as a force (compiled).

Both act on the two bodies of a contact at one point of N, with opposite signs, so they change neither the linear nor the angular momentum of
the two. A force that holds acts where the contact is in the middle of the tick.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from uwserver.physics.contact.solver import Constraints
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled


class Struck(NamedTuple):
    """What `step.strike` hands to `step.settle`, for k contacts of m bodies.

    Attributes:
        bodies: (m) rows of the bodies near a contact.
        M_inv: (m, 6, 6).
        constraints: of the contacts.
        drift: (k, 3) how far each contact goes in N within the tick, m.
        hit: (k, 3) impulse at the start of the tick along the axes, N s.
        hold: (k, 3) impulse of the force over the tick, likewise.
        final: (k) whether nothing is to be added at the end of the tick.
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
    rows: Array, bodies: Array, constraints: Constraints, point: Array, drift: Array, hold: Array, dt: float
) -> None:
    """Give impulses to the BODY rows as a force over the tick.

    Args:
        rows: of all bodies.
        bodies: (m) rows of those that the constraints name.
        constraints: of k contacts.
        point: (k, 3) at the start of the tick, in N, m.
        drift, hold: as in `Struck`.
        dt: s.
    """
    for c in range(point.shape[0]):
        if hold[c, 0] <= 0.0:
            continue
        a, b, axes = constraints.slot_a[c], constraints.slot_b[c], constraints.axes[c]
        _add_force(rows[bodies[a]], point[c], drift[c], axes, hold[c], 1.0 / dt)
        if b >= 0:
            _add_force(rows[bodies[b]], point[c], drift[c], axes, hold[c], -1.0 / dt)


@compiled
def _add_force(body: Any, point: Array, drift: Array, axes: Array, impulse: Array, scale: float) -> None:
    """Add to a BODY row the force of one contact, scale times its impulse, and its moment about N's origin."""
    body.in_contact = 1
    wrench = body.contact
    x, y, z = point[0] + 0.5 * drift[0], point[1] + 0.5 * drift[1], point[2] + 0.5 * drift[2]
    for d in range(3):
        size = scale * impulse[d]
        fx, fy, fz = size * axes[d, 0], size * axes[d, 1], size * axes[d, 2]
        wrench[0] += fx
        wrench[1] += fy
        wrench[2] += fz
        wrench[3] += y * fz - z * fy
        wrench[4] += z * fx - x * fz
        wrench[5] += x * fy - y * fx


@compiled
def clear_contact(body: Any) -> None:
    """No contact acts on a BODY row."""
    body.in_contact = 0
    for i in range(6):
        body.contact[i] = 0.0
