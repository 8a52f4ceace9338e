"""Separates bodies that penetrate each other by a displacement that never enters the velocity (compiled)."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.contact.solver import Constraints, solve_island
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import product, rotation, solve

SLOP = 1e-5  # m of penetration that is left alone; Bullet's own figure
RECOVERY = 0.2  # part of the penetration beyond that is recovered each tick
MAX_RECOVERY = 0.5  # m/s


@compiled
def recover(constraints: Constraints, M_inv: Array, gap: Array, dt: float, now: Array) -> None:
    """Displace bodies out of each other, by a part of the penetration in each tick.

    Args:
        constraints: constraints of k contacts of m bodies, at the poses in `now`.
        M_inv: (m, 6, 6).
        gap: (k) at the start of the tick, m.
        dt: s.
        now: (m, 13) states, in and out.
    """
    k, m = gap.shape[0], now.shape[0]
    bias, deep = np.zeros((k, 3)), False
    for c in range(k):
        if gap[c] < -SLOP:
            bias[c, 0] = max(RECOVERY * (gap[c] + SLOP) / dt, -MAX_RECOVERY)
            deep = True
        else:
            bias[c, 0] = max(0.0, gap[c]) / dt
    if not deep:
        return
    impulse, displacement = np.zeros((k, 3)), np.zeros((m, 6))
    smooth, free = np.zeros(k), np.zeros(k, np.bool_)
    for i in range(constraints.bounds.shape[0] - 1):
        solve_island(constraints, i, bias, smooth, free, impulse, displacement)
    before = now.copy()
    for i in range(m):
        moves = False
        for j in range(6):
            moves = moves or displacement[i, j] != 0.0
        if moves:
            _displace(now[i], displacement[i], dt)
    for i in range(constraints.bounds.shape[0] - 1):
        _keep_momentum(constraints, i, M_inv, before, now)


@compiled
def _displace(x: Array, velocity: Array, dt: float) -> None:
    """Move the pose of x (13) for a time dt with a velocity (6) in its axes."""
    R = np.empty((3, 3))
    rotation(x[3], x[4], x[5], x[6], R)
    for i in range(3):
        x[i] += dt * (R[i, 0] * velocity[0] + R[i, 1] * velocity[1] + R[i, 2] * velocity[2])
    rate = math.sqrt(velocity[3] ** 2 + velocity[4] ** 2 + velocity[5] ** 2)
    half = 0.5 * dt * rate
    s = 0.5 * dt if half < 1e-8 else math.sin(half) / rate
    w, a, b, c = math.cos(half), s * velocity[3], s * velocity[4], s * velocity[5]
    x[3], x[4], x[5], x[6] = product(x[3], x[4], x[5], x[6], w, a, b, c)
    norm = math.sqrt(x[3] ** 2 + x[4] ** 2 + x[5] ** 2 + x[6] ** 2)
    for i in range(3, 7):
        x[i] /= norm


@compiled
def _keep_momentum(constraints: Constraints, island: int, M_inv: Array, before: Array, now: Array) -> None:
    """Give displaced bodies velocities with which they and the water keep their momentum in N, linear and angular about its origin.

    This is done in islands that touch nothing fixed. The bodies of other islands keep their velocities in B, and so their kinetic energy.
    """
    order, bounds = constraints.order, constraints.bounds
    there = np.zeros(now.shape[0], np.bool_)
    for k in range(bounds[island], bounds[island + 1]):
        c = order[k]
        if constraints.slot_b[c] < 0:
            return
        there[constraints.slot_a[c]] = there[constraints.slot_b[c]] = True
    h, won, whole, R = np.zeros((now.shape[0], 6)), np.zeros(3), 0.0, np.empty((3, 3))
    for i in range(now.shape[0]):
        if there[i]:
            whole += _momentum(M_inv[i], before[i], R, h[i])
            x, y, z = now[i, 0] - before[i, 0], now[i, 1] - before[i, 1], now[i, 2] - before[i, 2]
            won[0] += y * h[i, 2] - z * h[i, 1]
            won[1] += z * h[i, 0] - x * h[i, 2]
            won[2] += x * h[i, 1] - y * h[i, 0]
    for i in range(now.shape[0]):
        if there[i]:
            share = _inertia(M_inv[i]) / whole
            rotation(now[i, 3], now[i, 4], now[i, 5], now[i, 6], R)
            for r in range(6):
                now[i, 7 + r] = 0.0
                for j in range(3):
                    for n in range(3):
                        spin = h[i, 3 + n] - share * won[n]
                        now[i, 7 + r] += (M_inv[i, r, j] * h[i, n] + M_inv[i, r, 3 + j] * spin) * R[n, j]


@compiled
def _inertia(M_inv: Array) -> float:
    """Return a mean moment of inertia, by which bodies share a change of angular momentum."""
    return 1.0 / float(M_inv[3, 3] + M_inv[4, 4] + M_inv[5, 5])


@compiled
def _momentum(M_inv: Array, x: Array, R: Array, h: Array) -> float:
    """Add to h (6) the linear and angular momentum, about the body's origin in N, of a body and its water at x (13). Return `_inertia`."""
    own = np.empty((6, 1))
    for i in range(6):
        own[i, 0] = x[7 + i]
    solve(M_inv.copy(), own)
    rotation(x[3], x[4], x[5], x[6], R)
    for i in range(3):
        for j in range(3):
            h[i] += R[i, j] * own[j, 0]
            h[3 + i] += R[i, j] * own[3 + j, 0]
    return _inertia(M_inv)
