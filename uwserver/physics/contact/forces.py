"""How contact impulses act on bodies within a tick: hits at once, what holds as a force (compiled).

Both act on the two bodies of a contact at one point of N, with opposite signs, so they change neither the linear nor the angular momentum of
the two. A force that holds is constant in the tick, and its point moves on with the contact.
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
    rows: Array, bodies: Array, constraints: Constraints, point: Array, drift: Array, hold: Array, t: float, dt: float
) -> None:  # fmt: skip
    """Give impulses to the BODY rows as a force over the tick.

    Args:
        rows: of all bodies.
        bodies: (m) rows of those that the constraints name.
        constraints: of k contacts.
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
    """Add to a BODY row the force of one contact, and its moment."""
    body.in_contact = 1
    wrench, scale = body.contact, sign / dt
    wrench[9] = t
    for d in range(3):
        size = scale * impulse[d]
        fx, fy, fz = size * axes[d, 0], size * axes[d, 1], size * axes[d, 2]
        wrench[0] += fx
        wrench[1] += fy
        wrench[2] += fz
        wrench[3] += point[1] * fz - point[2] * fy
        wrench[4] += point[2] * fx - point[0] * fz
        wrench[5] += point[0] * fy - point[1] * fx
        wrench[6] += (drift[1] * fz - drift[2] * fy) / dt
        wrench[7] += (drift[2] * fx - drift[0] * fz) / dt
        wrench[8] += (drift[0] * fy - drift[1] * fx) / dt


@compiled
def clear_contact(body: Any) -> None:
    """No contact acts on a BODY row."""
    body.in_contact = 0
    for i in range(10):
        body.contact[i] = 0.0
