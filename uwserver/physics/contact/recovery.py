"""Bodies that are in each other are taken apart by a displacement, which never enters the velocity (compiled)."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.contact.solver import Constraints, solve_island
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import solve
from uwserver.physics.kernel.rotation import product, rotation

SLOP = 1e-5  # m of penetration that is left alone; Bullet's own figure
RECOVERY = 0.2  # part of the penetration beyond that is recovered each tick
MAX_RECOVERY = 0.5  # m/s


@compiled
def recover(constraints: Constraints, M_inv: Array, gap: Array, dt: float, now: Array) -> None:
    """Displace bodies out of each other, by part of the penetration a tick.

    Args:
        constraints: of k contacts of m bodies, at the poses in `now`.
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
    for i in range(m):
        moves = False
        for j in range(6):
            moves = moves or displacement[i, j] != 0.0
        if moves:
            _displace(now[i], displacement[i], M_inv[i], dt)


@compiled
def _displace(x: Array, velocity: Array, M_inv: Array, dt: float) -> None:
    """Carry the pose of x (13) on for dt at a velocity (6) in its axes. Its own velocity changes so that the momentum keeps its direction in N."""
    before, after = np.empty((3, 3)), np.empty((3, 3))
    rotation(x[3], x[4], x[5], x[6], before)
    for i in range(3):
        x[i] += dt * (before[i, 0] * velocity[0] + before[i, 1] * velocity[1] + before[i, 2] * velocity[2])
    rate = math.sqrt(velocity[3] ** 2 + velocity[4] ** 2 + velocity[5] ** 2)
    half = 0.5 * dt * rate
    s = 0.5 * dt if half < 1e-8 else math.sin(half) / rate
    w, a, b, c = math.cos(half), s * velocity[3], s * velocity[4], s * velocity[5]
    x[3], x[4], x[5], x[6] = product(x[3], x[4], x[5], x[6], w, a, b, c)
    norm = math.sqrt(x[3] ** 2 + x[4] ** 2 + x[5] ** 2 + x[6] ** 2)
    for i in range(3, 7):
        x[i] /= norm
    rotation(x[3], x[4], x[5], x[6], after)
    momentum, turned = np.empty((6, 1)), np.zeros(6)
    for i in range(6):
        momentum[i, 0] = x[7 + i]
    solve(M_inv.copy(), momentum)
    for i in range(3):
        for j in range(3):
            turn = after[0, i] * before[0, j] + after[1, i] * before[1, j] + after[2, i] * before[2, j]
            turned[i] += turn * momentum[j, 0]
            turned[3 + i] += turn * momentum[3 + j, 0]
    for i in range(6):
        x[7 + i] = 0.0
        for j in range(6):
            x[7 + i] += M_inv[i, j] * turned[j]
