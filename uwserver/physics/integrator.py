"""One tick for all bodies of a world in one compiled call: RK4 with sub-steps, and a linearly implicit fallback for stiff bodies.

RK4 is stable while rate * dt < 2.78; sub-steps keep rate * dt / n below 1.5, where `rate` bounds the fastest damping rate at the present
velocity (`bodies.damping_rates`). A body that would need more than 16 sub-steps is stepped by the Rosenbrock-Euler rule instead, with the
damping's Jacobian: first order, and stable at any step.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.physics.compiled import compiled
from uwserver.physics.fossen import derivative, rotation
from uwserver.physics.immersion import immersion
from uwserver.physics.layout import STATE_SIZE
from uwserver.physics.thrust import advance_lag, lagged, set_demand

Array = Any  # numpy array inside compiled code

MAX_LEVEL = 4
STABLE = 1.5
DIVERGED_SPEED = 1e6  # m/s or rad/s: long before numbers overflow


@compiled
def _damping_rate(body: Any, x: Array, current: Array) -> float:
    """Upper bound of the fastest damping rate, 1/s, at a state."""
    speed = math.sqrt(current[0] ** 2 + current[1] ** 2 + current[2] ** 2)
    rate = float(body.rate_L)
    for j in range(3):
        rate += body.rate_Q[j] * (abs(x[7 + j]) + speed)
        rate += body.rate_Q[3 + j] * abs(x[10 + j])
    return float(rate + body.rate_S * (abs(x[7]) + speed))


@compiled
def _hold_inertia(body: Any, shapes: Array, x: Array, R: Array, scratch: Array, M_inv: Array) -> float:
    """Submerged fraction at the start of a step, and the inverse inertia that goes with it."""
    fraction = 1.0
    if body.shape_count > 0 and x[2] < body.radius:
        rotation(x, R)
        fraction = immersion(body, shapes, x[2], R, scratch[2], scratch)
    if fraction == 1.0:
        M_inv[:, :] = body.M_inv
    else:
        M_inv[:, :] = np.linalg.inv(body.M_RB + fraction * body.M_A)
    return fraction


@compiled
def _normalise(x: Array) -> None:
    n = math.sqrt(x[3] ** 2 + x[4] ** 2 + x[5] ** 2 + x[6] ** 2)
    for i in range(3, 7):
        x[i] /= n


@compiled
def _rk4(
    body: Any, x: Array, t: float, h: float, level: int, current: Array, shapes: Array, thrusters: Array, lags: Array, wrenches: Array,
    M_inv: Array, held: float, forces: Array, s: Array, R: Array, work: Array, external: Array,
) -> None:  # fmt: skip
    """One classical Runge-Kutta step of length h, in place. `s` (6, 13) and `work` (6, 6) are scratch.

    The lag of the thrusters does not depend on the body, so its exact values at the three stage times are inserted.
    """
    y = s[4]
    first, count = body.thruster_first, body.thruster_count
    for k in range(count):
        thruster = thrusters[first + k]
        lag = lags[thruster.lag]
        forces[0, k] = lagged(thruster, lag)
        forces[1, k] = advance_lag(thruster, lag, level)
        forces[2, k] = advance_lag(thruster, lag, level)
    derivative(body, x, t, current, shapes, thrusters, forces[0], wrenches, M_inv, held, work, R, s[0], external)
    for i in range(STATE_SIZE):
        y[i] = x[i] + 0.5 * h * s[0, i]
    derivative(body, y, t + 0.5 * h, current, shapes, thrusters, forces[1], wrenches, M_inv, held, work, R, s[1], external)
    for i in range(STATE_SIZE):
        y[i] = x[i] + 0.5 * h * s[1, i]
    derivative(body, y, t + 0.5 * h, current, shapes, thrusters, forces[1], wrenches, M_inv, held, work, R, s[2], external)
    for i in range(STATE_SIZE):
        y[i] = x[i] + h * s[2, i]
    derivative(body, y, t + h, current, shapes, thrusters, forces[2], wrenches, M_inv, held, work, R, s[3], external)
    for i in range(STATE_SIZE):
        x[i] += h / 6.0 * (s[0, i] + 2.0 * (s[1, i] + s[2, i]) + s[3, i])
    _normalise(x)


@compiled
def _implicit(
    body: Any, x: Array, t: float, h: float, current: Array, shapes: Array, thrusters: Array, lags: Array, wrenches: Array,
    M_inv: Array, held: float, forces: Array, s: Array, R: Array, work: Array, external: Array,
) -> None:  # fmt: skip
    """Rosenbrock-Euler: (M + h dD/dnu) delta_nu = h M nu_dot, then the pose by the new velocity."""
    first, count = body.thruster_first, body.thruster_count
    for k in range(count):
        thruster = thrusters[first + k]
        advance_lag(thruster, lags[thruster.lag], 0)
        forces[2, k] = advance_lag(thruster, lags[thruster.lag], 0)
    derivative(body, x, t + 0.5 * h, current, shapes, thrusters, forces[2], wrenches, M_inv, held, work, R, s[0], external)
    nu_r = work[0]
    A = body.M_RB + held * body.M_A
    tau = A @ s[0, 7:13]
    for i in range(6):
        for j in range(6):
            slope = body.D_L[i, j] + 2.0 * body.D_Q[i, j] * abs(nu_r[j]) + body.D_S[i, j] * abs(nu_r[0])
            A[i, j] += h * held * slope
    delta = np.linalg.solve(A, tau)
    y = s[4]
    for i in range(STATE_SIZE):
        y[i] = x[i]
    for i in range(6):
        y[7 + i] = x[7 + i] + h * delta[i]
    derivative(body, y, t + h, current, shapes, thrusters, forces[2], wrenches, M_inv, held, work, R, s[1], external)
    for i in range(7):
        x[i] += h * s[1, i]
    for i in range(7, STATE_SIZE):
        x[i] = y[i]
    _normalise(x)


@compiled
def advance(
    bodies: Array, state: Array, currents: Array, shapes: Array, thrusters: Array, tables: Array, lags: Array, wrenches: Array,
    t: float, dt: float,
) -> int:  # fmt: skip
    """Carry all bodies from t to t + dt, in place.

    Args:
        bodies: (n) BODY.
        state: (n, 13) p_NB, q_NB, nu.
        currents: (n, 3) water velocity at each body in N, m/s, constant in the tick.
        shapes, thrusters, tables, lags, wrenches: all SHAPE, THRUSTER, TABLE, LAG and WRENCH rows.
        t, dt: start and length of the tick, s.

    Returns:
        -1, or the row of the first body whose state is not finite or absurdly fast.
    """
    n_forces = max(1, thrusters.shape[0])
    s, work, R, forces = np.empty((6, STATE_SIZE)), np.empty((6, 6)), np.empty((3, 3)), np.empty((3, n_forces))
    M_inv, external, scratch = np.empty((6, 6)), np.empty(6), np.empty((3, 3))
    for k in range(thrusters.shape[0]):
        set_demand(thrusters[k], tables)
    for n in range(bodies.shape[0]):
        body, x, current = bodies[n], state[n], currents[n]
        held = _hold_inertia(body, shapes, x, R, scratch, M_inv)
        need = _damping_rate(body, x, current) * dt / STABLE
        level, steps = 0, 1
        while steps < need and level < MAX_LEVEL:
            level += 1
            steps *= 2
        if need > steps:
            _implicit(body, x, t, dt, current, shapes, thrusters, lags, wrenches, M_inv, held, forces, s, R, work, external)
        else:
            h = dt / steps
            for k in range(steps):
                _rk4(
                    body, x, t + k * h, h, level, current, shapes, thrusters, lags, wrenches, M_inv, held, forces, s, R, work,
                    external,
                )  # fmt: skip
        for i in range(STATE_SIZE):
            # also false for NaN
            if not abs(x[i]) < 1e12 or (i >= 7 and not abs(x[i]) < DIVERGED_SPEED):
                return n
    return -1


@compiled
def rates_of_change(
    bodies: Array, state: Array, currents: Array, shapes: Array, thrusters: Array, lags: Array, wrenches: Array, t: float,
    nu_dot: Array, tau: Array,
) -> None:  # fmt: skip
    """Acceleration and applied wrench of all bodies at one instant, from the present lag states; changes no state.

    Args:
        nu_dot: (n, 6) out, derivative of nu in B, m/s2 and rad/s2.
        tau: (n, 6) out, thrust plus prescribed wrench about the origin in B, N and N m.
        others: as for `advance`.
    """
    n_forces = max(1, thrusters.shape[0])
    dx, work, R, forces = np.empty(STATE_SIZE), np.empty((6, 6)), np.empty((3, 3)), np.empty(n_forces)
    M_inv, scratch = np.empty((6, 6)), np.empty((3, 3))
    for n in range(bodies.shape[0]):
        body = bodies[n]
        held = _hold_inertia(body, shapes, state[n], R, scratch, M_inv)
        for k in range(body.thruster_count):
            thruster = thrusters[body.thruster_first + k]
            forces[k] = lagged(thruster, lags[thruster.lag])
        derivative(
            body, state[n], t, currents[n], shapes, thrusters, forces, wrenches, M_inv, held, work, R, dx, tau[n]
        )  # fmt: skip
        for i in range(6):
            nu_dot[n, i] = dx[7 + i]
