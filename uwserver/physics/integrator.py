"""One tick for all bodies of a world in one compiled call: RK4 with sub-steps, and a linearly implicit fallback for stiff bodies.

RK4 is stable while rate * dt < 2.78; sub-steps keep rate * dt / n below 1.5, where `rate` bounds the fastest damping rate at the present
velocity and at the one that the present acceleration leads to (`bodies.damping_rates`). A body that would need more than 16 sub-steps is
stepped by the Rosenbrock-Euler rule instead, with the damping's Jacobian: first order, and stable at any step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.compiled import compiled, inlined
from uwserver.physics.fossen import EXTERNAL, NU_R, SCRATCH_ROWS, derivative, rotation
from uwserver.physics.immersion import immersion
from uwserver.physics.layout import STATE_SIZE
from uwserver.physics.linear import solve
from uwserver.physics.thrust import advance_lag, lagged, set_demand

Array = Any  # numpy array inside compiled code

MAX_LEVEL = 4
STABLE = 1.5
DIVERGED_SPEED = 1e6  # m/s or rad/s: long before numbers overflow


# Rows of the (6, 13) scratch array of a step: four stage derivatives, a stage state, the state itself.
K1, K2, K3, K4, STAGE, STATE = range(6)


class Scratch(NamedTuple):
    """Work space of a step, allocated once a tick.

    Attributes:
        s: (6, 13) rows named above.
        forces: (3, n) lagged thrust of each thruster of a body at the three stage times, N.
        work: (9, 6) of `fossen.derivative`.
        R: (3, 3) R_NB.
        M_inv: (6, 6) inverse inertia that holds in the step.
        small: (3, 3).
    """

    s: Array
    forces: Array
    work: Array
    R: Array
    M_inv: Array
    small: Array


@compiled
def scratch(thrusters: int) -> Scratch:
    """Work space for a world with that many thrusters."""
    return Scratch(
        np.zeros((6, STATE_SIZE)), np.empty((3, max(1, thrusters))), np.zeros((SCRATCH_ROWS, 6)), np.empty((3, 3)), np.empty((6, 6)),
        np.empty((3, 3)),
    )  # fmt: skip


@compiled
def _damping_rate(body: Any, s: Array, current: Array, dt: float) -> float:
    """Upper bound of the fastest damping rate, 1/s, in a tick that starts at s[STATE] with the derivative s[K1].

    Quadratic damping has no rate at rest: a light body under a sudden force needs the speed that it will have.
    """
    speed = math.sqrt(current[0] ** 2 + current[1] ** 2 + current[2] ** 2)
    rate = float(body.rate_L)
    for j in range(6):
        nu = s[STATE, 7 + j]
        reached = max(abs(nu), abs(nu + dt * s[K1, 7 + j]))
        if j < 3:
            reached += speed
        rate += body.rate_Q[j] * reached
        if j == 0:
            rate += body.rate_S * reached
    return rate


@compiled
def _hold_inertia(rows: Any, body: Any, x: Array, dt: float, w: Scratch) -> float:
    """Submerged fraction that holds in a step; w.M_inv receives the inverse inertia that goes with it.

    The fraction is that of half a step on: with the one at its start a bobbing body, always late, would gain energy.
    """
    fraction = 1.0
    if body.shape_count > 0 and x[2] - dt * (abs(x[7]) + abs(x[8]) + abs(x[9])) < body.radius:
        R = w.R
        rotation(x[3], x[4], x[5], x[6], R)
        z = x[2] + 0.5 * dt * (R[2, 0] * x[7] + R[2, 1] * x[8] + R[2, 2] * x[9])
        fraction = immersion(body, rows.shapes, z, R, w.small[2], w.small)
    if fraction == 1.0:
        for i in range(6):
            for j in range(6):
                w.M_inv[i, j] = body.M_inv[i, j]
    else:
        M = body.M_RB + fraction * body.M_A
        for i in range(6):
            for j in range(6):
                w.M_inv[i, j] = 1.0 if i == j else 0.0
        solve(M, w.M_inv)
    return fraction


@inlined
def _rk4(
    rows: Any, body: Any, t: float, h: float, level: int, begun: bool, current: Array, held: float, w: Scratch
) -> None:
    """One classical Runge-Kutta step of length h of w.s[STATE], in place; `begun`: w.forces[0] and w.s[K1] are there already.

    The lag of the thrusters does not depend on the body, so its exact values at the three stage times are inserted.
    """
    shapes, thrusters, lags, wrenches = rows.shapes, rows.thrusters, rows.lags, rows.wrenches
    s, forces, M_inv, work, R = w.s, w.forces, w.M_inv, w.work, w.R
    first, count = body.thruster_first, body.thruster_count
    for k in range(count):
        thruster = thrusters[first + k]
        lag = lags[thruster.lag]
        if not begun:
            forces[0, k] = lagged(thruster, lag)
        forces[1, k] = advance_lag(thruster, lag, level)
        forces[2, k] = advance_lag(thruster, lag, level)
    if not begun:
        derivative(body, s, STATE, K1, t, current, shapes, thrusters, forces, 0, wrenches, M_inv, held, work, R)
    half = t + 0.5 * h
    for i in range(STATE_SIZE):
        s[STAGE, i] = s[STATE, i] + 0.5 * h * s[K1, i]
    derivative(body, s, STAGE, K2, half, current, shapes, thrusters, forces, 1, wrenches, M_inv, held, work, R)
    for i in range(STATE_SIZE):
        s[STAGE, i] = s[STATE, i] + 0.5 * h * s[K2, i]
    derivative(body, s, STAGE, K3, half, current, shapes, thrusters, forces, 1, wrenches, M_inv, held, work, R)
    for i in range(STATE_SIZE):
        s[STAGE, i] = s[STATE, i] + h * s[K3, i]
    derivative(body, s, STAGE, K4, t + h, current, shapes, thrusters, forces, 2, wrenches, M_inv, held, work, R)
    for i in range(STATE_SIZE):
        s[STATE, i] += h / 6.0 * (s[K1, i] + 2.0 * (s[K2, i] + s[K3, i]) + s[K4, i])
    _normalise(s)


@compiled
def _normalise(s: Array) -> None:
    """Unit length for the quaternion of s[STATE]."""
    n = math.sqrt(s[STATE, 3] ** 2 + s[STATE, 4] ** 2 + s[STATE, 5] ** 2 + s[STATE, 6] ** 2)
    for i in range(3, 7):
        s[STATE, i] /= n


@compiled
def _implicit(rows: Any, body: Any, t: float, h: float, current: Array, held: float, w: Scratch) -> None:
    """Rosenbrock-Euler: (M + h dD/dnu) delta_nu = h M nu_dot, then the pose by the new velocity."""
    shapes, thrusters, lags, wrenches = rows.shapes, rows.thrusters, rows.lags, rows.wrenches
    s, forces, M_inv, work, R = w.s, w.forces, w.M_inv, w.work, w.R
    first, count = body.thruster_first, body.thruster_count
    for k in range(count):
        thruster = thrusters[first + k]
        advance_lag(thruster, lags[thruster.lag], 0)
        forces[2, k] = advance_lag(thruster, lags[thruster.lag], 0)
    derivative(body, s, STATE, K1, t + 0.5 * h, current, shapes, thrusters, forces, 2, wrenches, M_inv, held, work, R)
    speed = abs(work[NU_R, 0])
    A = body.M_RB + held * body.M_A
    delta = np.zeros((6, 1))
    for i in range(6):
        for j in range(6):
            delta[i, 0] += A[i, j] * s[K1, 7 + j]
    for i in range(6):
        for j in range(6):
            slope = body.D_L[i, j] + 2.0 * body.D_Q[i, j] * abs(work[NU_R, j]) + body.D_S[i, j] * speed
            A[i, j] += h * held * slope
    # d(|u| D u)/du = 2 D |u|; the other derivatives by u are left out, they could make A singular.
    A[0, 0] += h * held * body.D_S[0, 0] * speed
    solve(A, delta)
    for i in range(STATE_SIZE):
        s[STAGE, i] = s[STATE, i]
    for i in range(6):
        s[STAGE, 7 + i] += h * delta[i, 0]
    derivative(body, s, STAGE, K2, t + h, current, shapes, thrusters, forces, 2, wrenches, M_inv, held, work, R)
    for i in range(7):
        s[STATE, i] += h * s[K2, i]
    for i in range(7, STATE_SIZE):
        s[STATE, i] = s[STAGE, i]
    _normalise(s)


@inlined
def step_body(rows: Any, n: int, x: Array, current: Array, t: float, dt: float, w: Scratch) -> float:
    """Carry body n from the state x (13) at t to t + dt without contact; w.s[STATE] receives the new state, the thrusters' lags move on.

    Returns:
        The submerged fraction that scaled M_A in the step; w.M_inv is the inverse inertia that goes with it.
    """
    body, shapes, thrusters, lags, wrenches = rows.bodies[n], rows.shapes, rows.thrusters, rows.lags, rows.wrenches
    s, forces, M_inv, work, R = w.s, w.forces, w.M_inv, w.work, w.R
    for i in range(STATE_SIZE):
        s[STATE, i] = x[i]
    held = _hold_inertia(rows, body, x, dt, w)
    for k in range(body.thruster_count):
        thruster = thrusters[body.thruster_first + k]
        forces[0, k] = lagged(thruster, lags[thruster.lag])
    derivative(body, s, STATE, K1, t, current, shapes, thrusters, forces, 0, wrenches, M_inv, held, work, R)
    need = _damping_rate(body, s, current, dt) * dt / STABLE
    level, steps = 0, 1
    while steps < need and level < MAX_LEVEL:
        level += 1
        steps *= 2
    if need > steps:
        _implicit(rows, body, t, dt, current, held, w)
    else:
        h = dt / steps
        for k in range(steps):
            _rk4(rows, body, t + k * h, h, level, k == 0, current, held, w)
    return held


@compiled
def keep_state(s: Array, x: Array) -> bool:
    """Copy s[STATE] to x (13); False if it is not finite or absurdly fast."""
    sound = True
    for i in range(STATE_SIZE):
        value = s[STATE, i]
        x[i] = value
        # also false for NaN
        if not abs(value) < 1e12 or (i >= 7 and not abs(value) < DIVERGED_SPEED):
            sound = False
    return sound


@compiled
def advance(rows: Any, state: Array, currents: Array, t: float, dt: float) -> int:
    """Carry all bodies from t to t + dt, in place.

    Args:
        rows: `layout.Rows` of the world.
        state: (n, 13) p_NB, q_NB, nu.
        currents: (n, 3) water velocity at each body in N, m/s, constant in the tick.
        t, dt: start and length of the tick, s.

    Returns:
        -1, or the row of the first body whose state is not finite or absurdly fast.
    """
    thrusters = rows.thrusters
    w = scratch(thrusters.shape[0])
    for k in range(thrusters.shape[0]):
        set_demand(thrusters[k], rows.tables)
    for n in range(rows.bodies.shape[0]):
        step_body(rows, n, state[n], currents[n], t, dt, w)
        if not keep_state(w.s, state[n]):
            return n
    return -1


@compiled
def rates_of_change(rows: Any, state: Array, currents: Array, t: float, nu_dot: Array, tau: Array) -> None:
    """Acceleration and applied wrench of all bodies at one instant, from the present lag states; changes no state.

    Args:
        nu_dot: (n, 6) out, derivative of nu in B, m/s2 and rad/s2.
        tau: (n, 6) out, thrust plus prescribed wrench about the origin in B, N and N m.
        others: as for `advance`.
    """
    w = scratch(rows.thrusters.shape[0])
    shapes, thrusters, lags, wrenches = rows.shapes, rows.thrusters, rows.lags, rows.wrenches
    s, forces, M_inv, work, R = w.s, w.forces, w.M_inv, w.work, w.R
    for n in range(rows.bodies.shape[0]):
        body = rows.bodies[n]
        for i in range(STATE_SIZE):
            s[STATE, i] = state[n, i]
        held = _hold_inertia(rows, body, state[n], 0.0, w)
        for k in range(body.thruster_count):
            thruster = thrusters[body.thruster_first + k]
            forces[0, k] = lagged(thruster, lags[thruster.lag])
        derivative(body, s, STATE, K1, t, currents[n], shapes, thrusters, forces, 0, wrenches, M_inv, held, work, R)
        for i in range(6):
            nu_dot[n, i] = s[K1, 7 + i]
            tau[n, i] = w.work[EXTERNAL, i]
