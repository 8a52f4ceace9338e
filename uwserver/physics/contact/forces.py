"""How contact impulses act on bodies within a tick: hits at once, what holds as a force (compiled)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.contact.solver import Constraints, add_response
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled


class Struck(NamedTuple):
    """What `step.strike` hands to `step.settle`, for k contacts of m bodies.

    Attributes:
        bodies: (m) rows of the bodies near a contact.
        start: (m, 13) their states at the start of the tick.
        M_inv: (m, 6, 6).
        constraints: of the contacts.
        impulse: (k, 3) along the axes, N s.
        bounced: (k) whether the contact was a hit that bounces.
        change: (m, 6) of nu by all impulses of the tick.
    """

    bodies: Array
    start: Array
    M_inv: Array
    constraints: Constraints
    impulse: Array
    bounced: Array
    change: Array


@compiled
def apply_impulses(bodies: Array, struck: Struck, point: Array, state: Array, dt: float) -> None:
    """Let hits change the velocity at once, and give what holds to the BODY rows as a force over the tick."""
    jump, constraints = np.zeros(struck.change.shape), struck.constraints
    for c in range(point.shape[0]):
        a, b, impulse = constraints.slot_a[c], constraints.slot_b[c], struck.impulse[c]
        if impulse[0] <= 0.0:
            continue
        if struck.bounced[c]:
            add_response(constraints.rows, c, impulse, a, b, jump)
        else:
            _add_force(bodies[struck.bodies[a]], struck.start[a], point[c], constraints.axes[c], impulse, 1.0 / dt)
            if b >= 0:
                _add_force(bodies[struck.bodies[b]], struck.start[b], point[c], constraints.axes[c], impulse, -1.0 / dt)
    for i in range(struck.bodies.shape[0]):
        for j in range(6):
            state[struck.bodies[i], 7 + j] += jump[i, j]


@compiled
def _add_force(body: Any, p: Array, point: Array, axes: Array, impulse: Array, scale: float) -> None:
    """Add a force, scale times the impulse at the point, to the BODY row of a body whose origin is at p."""
    body.in_contact = 1
    wrench = body.contact
    F = np.zeros(3)
    for d in range(3):
        for i in range(3):
            F[i] += scale * impulse[d] * axes[d, i]
    x, y, z = point[0] - p[0], point[1] - p[1], point[2] - p[2]
    for i in range(3):
        wrench[i] += F[i]
    wrench[3] += y * F[2] - z * F[1]
    wrench[4] += z * F[0] - x * F[2]
    wrench[5] += x * F[1] - y * F[0]


@compiled
def clear_contact(body: Any) -> None:
    """No contact acts on a BODY row."""
    body.in_contact = 0
    for i in range(6):
        body.contact[i] = 0.0
