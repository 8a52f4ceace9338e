"""Contact rows: one unilateral normal and a disc of friction at each point, solved by projected Gauss-Seidel (compiled).

The velocity of body a relative to b at a point, along the normal and two tangents, is w = J nu. An impulse lambda there changes nu by
M^-1 J^T lambda, with the whole 6x6 M = M_RB + M_A of each body, and must satisfy

    0 <= lambda_n, 0 <= w_n, lambda_n w_n = 0                       (Signorini; w_n may be more where the gap is open)
    |lambda_t| <= mu lambda_n, and lambda_t opposes w_t where it is at the limit            (Coulomb's cone, not a box)

Bodies that touch each other, directly or through others, form an island; each island is solved by itself.
Sequential impulses: Catto, "Iterative dynamics with temporal coherence", 2005. The friction disc is enforced by projecting a gradient step, whose
fixed points are exactly Coulomb's law (de Saxce and Feng, 1998).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import rotation, to_body

MAX_SWEEPS = 300
TOLERANCE = 1e-10  # m/s: the largest change of a velocity by the last sweep
# Blocks of the (k, 4, 3, 6) array of rows: Jacobians of bodies a and b, and M^-1 J^T of both; three directions each.
J_A, J_B, R_A, R_B = range(4)


@compiled
def _root(parent: Array, i: int) -> int:
    while parent[i] != i:
        i = parent[i]
    return i


@compiled
def fill_slots(body: Array, slot_of: Array, bodies: Array, count: int, slots: Array) -> int:
    """Give each body a place in `bodies`, in the order in which the contacts name them. Return the number of bodies."""
    for c in range(body.shape[0]):
        row = body[c]
        slots[c] = -1
        if row >= 0:
            if slot_of[row] < 0:
                slot_of[row] = count
                bodies[count] = row
                count += 1
            slots[c] = slot_of[row]
    return count


@compiled
def find_islands(slot_a: Array, slot_b: Array, m: int, order: Array, bounds: Array) -> int:
    """Sort the contacts by islands, in the order of the first contact of each. Return the number of islands."""
    k = slot_a.shape[0]
    parent = np.arange(m)
    for c in range(k):
        if slot_b[c] >= 0:
            a, b = _root(parent, slot_a[c]), _root(parent, slot_b[c])
            parent[max(a, b)] = min(a, b)
    island = np.full(m, -1)
    size = np.zeros(m + 1, np.int64)
    count = 0
    for c in range(k):
        root = _root(parent, slot_a[c])
        if island[root] < 0:
            island[root] = count
            count += 1
        size[island[root]] += 1
    bounds[0] = 0
    for i in range(count):
        bounds[i + 1] = bounds[i] + size[i]
        size[i] = bounds[i]
    for c in range(k):
        i = island[_root(parent, slot_a[c])]
        order[size[i]] = c
        size[i] += 1
    return count


class Constraints(NamedTuple):
    """The constraints of k contacts between m bodies.

    Attributes:
        slot_a, slot_b: (k) places of the contacts' bodies among the m; -1 for a static solid.
        order, bounds: the contacts sorted by islands; island i is order[bounds[i]:bounds[i + 1]].
        axes: (k, 3, 3) normal and tangents in N.
        rows: (k, 4, 3, 6) blocks as named above.
        gains: (k, 2) of `set_gains`.
    """

    slot_a: Array
    slot_b: Array
    order: Array
    bounds: Array
    axes: Array
    rows: Array
    gains: Array


@compiled
def set_axes(normal: Array, axes: Array) -> None:
    """Write the normal and two tangents to axes (3, 3): a right-handed frame that depends on the normal alone."""
    x, y, z = normal[0], normal[1], normal[2]
    # Duff et al., "Building an orthonormal basis, revisited", 2017.
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    axes[0, 0], axes[0, 1], axes[0, 2] = x, y, z
    axes[1, 0], axes[1, 1], axes[1, 2] = 1.0 + sign * x * x * a, sign * b, -sign * x
    axes[2, 0], axes[2, 1], axes[2, 2] = b, sign + y * y * a, -y


@compiled
def set_jacobian(x: Array, point: Array, axes: Array, sign: float, R: Array, rows: Array, c: int, block: int) -> None:
    """Write the Jacobian of one body at contact c to rows[c, block].

    Args:
        x: (13) state of the body.
        point: (3) in N, m.
        axes: (3, 3) normal and tangents in N.
        sign: 1 for body a, -1 for body b.
        R: (3, 3) work space, receives R_NB.
        rows: (k, 4, 3, 6) out.
    """
    rotation(x[3], x[4], x[5], x[6], R)
    dx, dy, dz = point[0] - x[0], point[1] - x[1], point[2] - x[2]
    rx, ry, rz = to_body(R, dx, dy, dz)
    for d in range(3):
        ax, ay, az = sign * axes[d, 0], sign * axes[d, 1], sign * axes[d, 2]
        bx, by, bz = to_body(R, ax, ay, az)
        rows[c, block, d, 0], rows[c, block, d, 1], rows[c, block, d, 2] = bx, by, bz
        rows[c, block, d, 3] = ry * bz - rz * by
        rows[c, block, d, 4] = rz * bx - rx * bz
        rows[c, block, d, 5] = rx * by - ry * bx


@compiled
def set_response(M_inv: Array, slot: int, rows: Array, c: int, block: int) -> None:
    """Write M_inv[slot] J^T to rows[c, block + 2], for the Jacobian in rows[c, block]; M_inv (m, 6, 6)."""
    for d in range(3):
        for i in range(6):
            total = 0.0
            for j in range(6):
                total += M_inv[slot, i, j] * rows[c, block, d, j]
            rows[c, block + 2, d, i] = total


@compiled
def relative_velocity(rows: Array, c: int, d: int, nu: Array, a: int, b: int) -> float:
    """Return w of contact c in direction d, m/s, for the velocities nu (m, 6) of bodies a and b; b is -1 for a static solid."""
    w = 0.0
    for i in range(6):
        w += rows[c, J_A, d, i] * nu[a, i]
    if b >= 0:
        for i in range(6):
            w += rows[c, J_B, d, i] * nu[b, i]
    return w


@compiled
def set_jacobians(constraints: Constraints, state: Array, point: Array, rows: Array, R: Array) -> None:
    """Write the Jacobians of all contacts at points (k, 3), for the poses in `state` (m, 13), to rows (k, 4, 3, 6). R (3, 3) is work space."""
    slot_a, slot_b, axes = constraints.slot_a, constraints.slot_b, constraints.axes
    for c in range(point.shape[0]):
        set_jacobian(state[slot_a[c]], point[c], axes[c], 1.0, R, rows, c, J_A)
        if slot_b[c] >= 0:
            set_jacobian(state[slot_b[c]], point[c], axes[c], -1.0, R, rows, c, J_B)


@compiled
def set_responses(constraints: Constraints, M_inv: Array) -> None:
    """Compute responses and gains of all contacts for the inverse inertias M_inv (m, 6, 6), after `set_jacobians`."""
    slot_a, slot_b, rows = constraints.slot_a, constraints.slot_b, constraints.rows
    for c in range(slot_a.shape[0]):
        set_response(M_inv, slot_a[c], rows, c, J_A)
        if slot_b[c] >= 0:
            set_response(M_inv, slot_b[c], rows, c, J_B)
        set_gains(rows, c, slot_b[c] >= 0, constraints.gains[c])


@compiled
def _coupling(rows: Array, c: int, d: int, e: int, moving_b: bool) -> float:
    """Return the change of w in direction d by a unit impulse in direction e of the same contact, 1/kg."""
    total = 0.0
    for i in range(6):
        total += rows[c, J_A, d, i] * rows[c, R_A, e, i]
    if moving_b:
        for i in range(6):
            total += rows[c, J_B, d, i] * rows[c, R_B, e, i]
    return total


@compiled
def set_gains(rows: Array, c: int, moving_b: bool, gains: Array) -> None:
    """Write to gains (2): 1 / A_nn of the normal row, and 1 / the largest eigenvalue of the 2x2 block of the tangents, kg."""
    gains[0] = 1.0 / _coupling(rows, c, 0, 0, moving_b)
    p, q, r = _coupling(rows, c, 1, 1, moving_b), _coupling(rows, c, 1, 2, moving_b), _coupling(rows, c, 2, 2, moving_b)
    gains[1] = 1.0 / (0.5 * (p + r) + math.sqrt(0.25 * (p - r) ** 2 + q * q))


@compiled
def _respond(rows: Array, c: int, d: int, impulse: float, a: int, b: int, change: Array) -> None:
    """Add the effect of an impulse in direction d to the velocity changes of both bodies."""
    for i in range(6):
        change[a, i] += rows[c, R_A, d, i] * impulse
    if b >= 0:
        for i in range(6):
            change[b, i] += rows[c, R_B, d, i] * impulse


@compiled
def add_response(rows: Array, c: int, impulse: Array, a: int, b: int, change: Array) -> None:
    """Add the effect of an impulse (3) along normal and tangents to the velocity changes of both bodies."""
    for d in range(3):
        if impulse[d] != 0.0:
            _respond(rows, c, d, impulse[d], a, b, change)


@compiled
def solve_island(
    constraints: Constraints, island: int, bias: Array, friction: Array, frozen: Array, impulse: Array, change: Array
) -> int:
    """Solve the contacts of one island by projected Gauss-Seidel.

    Args:
        constraints: constraints of all contacts.
        island: number of the island.
        bias: (k, 3) w without any change of velocity, plus what the open gap allows along the normal.
        friction: (k) coefficients.
        frozen: (k) contacts whose impulses stay as they are.
        impulse: (k, 3) in and out, N s; the effect of its values at the start is part of `change` or of the bias already.
        change: (m, 6) in and out, change of nu of each body.

    Returns:
        The number of sweeps.
    """
    order, rows, gains = constraints.order, constraints.rows, constraints.gains
    first, end = constraints.bounds[island], constraints.bounds[island + 1]
    for sweep in range(MAX_SWEEPS):
        worst = 0.0
        for k in range(first, end):
            c = order[k]
            if frozen[c]:
                continue
            a, b = constraints.slot_a[c], constraints.slot_b[c]
            w = bias[c, 0] + relative_velocity(rows, c, 0, change, a, b)
            new = max(0.0, impulse[c, 0] - gains[c, 0] * w)
            step = new - impulse[c, 0]
            if step != 0.0:
                impulse[c, 0] = new
                _respond(rows, c, 0, step, a, b, change)
                worst = max(worst, abs(step) / gains[c, 0])
            if friction[c] <= 0.0:
                continue
            u = impulse[c, 1] - gains[c, 1] * (bias[c, 1] + relative_velocity(rows, c, 1, change, a, b))
            v = impulse[c, 2] - gains[c, 1] * (bias[c, 2] + relative_velocity(rows, c, 2, change, a, b))
            limit, size = friction[c] * impulse[c, 0], math.sqrt(u * u + v * v)
            if size > limit:
                u, v = u * limit / size, v * limit / size
            du, dv = u - impulse[c, 1], v - impulse[c, 2]
            if du != 0.0 or dv != 0.0:
                impulse[c, 1], impulse[c, 2] = u, v
                _respond(rows, c, 1, du, a, b, change)
                _respond(rows, c, 2, dv, a, b, change)
                worst = max(worst, math.sqrt(du * du + dv * dv) / gains[c, 1])
        if worst <= TOLERANCE:
            return sweep + 1
    return MAX_SWEEPS
