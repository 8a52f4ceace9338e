"""How contact impulses act on bodies within a tick: hits at once, what holds as a force (compiled)."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.contact.solver import push_all
from uwserver.physics.kernel.compiled import compiled

Array = Any  # numpy array inside compiled code


@compiled
def act(rows: Array, struck: Any, point: Array, state: Array, dt: float) -> None:
    """Let hits change the velocity at once, and give what holds to the BODY rows as a force over the tick."""
    jump = np.zeros(struck.change.shape)
    for c in range(point.shape[0]):
        a, b, impulse = struck.slot_a[c], struck.slot_b[c], struck.impulse[c]
        if impulse[0] <= 0.0:
            continue
        if struck.bounced[c]:
            push_all(struck.rows, c, impulse, a, b, jump)
        else:
            _press(rows, struck, a, point[c], struck.axes[c], impulse, 1.0 / dt)
            if b >= 0:
                _press(rows, struck, b, point[c], struck.axes[c], impulse, -1.0 / dt)
    for i in range(struck.bodies.shape[0]):
        for j in range(6):
            state[struck.bodies[i], 7 + j] += jump[i, j]


@compiled
def _press(rows: Array, struck: Any, slot: int, point: Array, axes: Array, impulse: Array, scale: float) -> None:
    """Add a force, scale times the impulse at the point, to the BODY row of the body in a slot."""
    row, p = rows[struck.bodies[slot]], struck.start[slot]
    row.touching = 1
    touch = row.touch
    F = np.zeros(3)
    for d in range(3):
        for i in range(3):
            F[i] += scale * impulse[d] * axes[d, i]
    x, y, z = point[0] - p[0], point[1] - p[1], point[2] - p[2]
    for i in range(3):
        touch[i] += F[i]
    touch[3] += y * F[2] - z * F[1]
    touch[4] += z * F[0] - x * F[2]
    touch[5] += x * F[1] - y * F[0]


@compiled
def let_go(row: Any) -> None:
    """No contact acts on a BODY row."""
    row.touching = 0
    for i in range(6):
        row.touch[i] = 0.0
