"""One tick for all bodies of a world in one compiled call: RK4 with sub-steps, and a linearly implicit fallback for stiff bodies.

RK4 is stable while rate * dt < 2.78; sub-steps keep rate * dt / n below 1.5, where `rate` bounds the fastest damping rate at the present
velocity and at the one that the present acceleration leads to (`bodies.damping_rates`). A body that would need more than 16 sub-steps is
stepped by the Rosenbrock-Euler rule instead, with the damping's Jacobian: first order, and stable at any step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.dynamics.appendages import appendages
from uwserver.physics.dynamics.fossen import ACTUATED, EXTERNAL, NU_R, PASSIVE, SCRATCH_ROWS, derivative, rotation
from uwserver.physics.dynamics.immersion import depth_below, immersion, upward
from uwserver.physics.dynamics.servo import advance_servo
from uwserver.physics.dynamics.thruster import advance_lag, lagged, set_demand
from uwserver.physics.kernel.compiled import compiled, inlined
from uwserver.physics.kernel.handles import fitted_at, flows_at, is_fitted, rows_at, state_at
from uwserver.physics.kernel.layout import FLOW_PLANE, FLOW_V, STATE_SIZE
from uwserver.physics.kernel.linear import solve

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
        values: (3, n) value of each servo of a body at the three stage times.
        work: (13, 6) of `fossen.derivative`.
        R: (3, 3) R_NB.
        M_inv: (6, 6) inverse inertia that holds in the step.
        small: (3, 3).
    """

    s: Array
    forces: Array
    values: Array
    work: Array
    R: Array
    M_inv: Array
    small: Array


@compiled
def servo_count(fitted: Any) -> int:
    """Number of servos of a world."""
    if fitted is None:
        return 0
    return int(fitted.servos.shape[0])


@compiled
def scratch(thrusters: int, servos: int) -> Scratch:
    """Work space for a world with that many thrusters and servos."""
    return Scratch(
        np.zeros((6, STATE_SIZE)), np.empty((3, max(1, thrusters))), np.empty((3, max(1, servos))), np.zeros((SCRATCH_ROWS, 6)),
        np.empty((3, 3)), np.empty((6, 6)), np.empty((3, 3)),
    )  # fmt: skip


@compiled
def _damping_rate(body: Any, s: Array, flow: Array, dt: float) -> float:
    """Upper bound of the fastest damping rate, 1/s, in a tick that starts at s[STATE] with the derivative s[K1].

    Quadratic damping has no rate at rest: a light body under a sudden force needs the speed that it will have.
    """
    speed = math.sqrt(flow[FLOW_V] ** 2 + flow[FLOW_V + 1] ** 2 + flow[FLOW_V + 2] ** 2)
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
def _hold_inertia(shapes: Array, body: Any, x: Array, flow: Array, t: float, dt: float, w: Scratch) -> float:
    """Submerged fraction that holds in a step; w.M_inv receives the inverse inertia that goes with it.

    The fraction is that of half a step on: with the one at its start a bobbing body, always late, would gain energy.
    """
    fraction = 1.0
    reach = body.radius + dt * (abs(x[7]) + abs(x[8]) + abs(x[9]) + abs(flow[FLOW_PLANE + 3]))
    if body.shape_count > 0 and depth_below(flow, x[0], x[1], x[2], t) < reach:
        R, half = w.R, 0.5 * dt
        rotation(x[3], x[4], x[5], x[6], R)
        on_x = x[0] + half * (R[0, 0] * x[7] + R[0, 1] * x[8] + R[0, 2] * x[9])
        on_y = x[1] + half * (R[1, 0] * x[7] + R[1, 1] * x[8] + R[1, 2] * x[9])
        on_z = x[2] + half * (R[2, 0] * x[7] + R[2, 1] * x[8] + R[2, 2] * x[9])
        upward(flow, R, w.small[0])
        fraction = immersion(body, shapes, depth_below(flow, on_x, on_y, on_z, t + half), w.small[2], w.small)
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


@compiled
def _advance_servos(servos: Array, body: Any, half: float, w: Scratch) -> None:
    """w.values (3, n) of the body's servos now, `half` (s) on and twice that on; the servos move on to the last."""
    for k in range(body.servo_count):
        servo = servos[body.servo_first + k]
        w.values[0, k] = servo.value
        w.values[1, k] = advance_servo(servo, half)
        w.values[2, k] = advance_servo(servo, half)


@compiled
def _present_appendages(rows: Any, fitted: Any, body: Any, t: float, flow: Array, w: Scratch) -> None:
    """Wrench of the body's appendages at w.s[STATE], from the present values of its servos, in w.work."""
    for k in range(body.servo_count):
        w.values[0, k] = fitted.servos[body.servo_first + k].value
    appendages(rows.shapes, fitted, body, w.s, STATE, 0, t, flow, w)


@compiled
def _no_appendages(w: Scratch) -> None:
    """For the next body."""
    for i in range(6):
        w.work[ACTUATED, i] = w.work[PASSIVE, i] = 0.0


@inlined
def _rk4(
    rows: Any,
    body: Any,
    t: float,
    h: float,
    level: int,
    begun: bool,
    flow: Array,
    held: float,
    w: Scratch,
    fitted: Any,
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
    if fitted is not None:
        _advance_servos(fitted.servos, body, 0.5 * h, w)
    if not begun:
        if fitted is not None:
            appendages(rows.shapes, fitted, body, s, STATE, 0, t, flow, w)
        derivative(body, s, STATE, K1, t, flow, shapes, thrusters, forces, 0, wrenches, M_inv, held, work, R)
    half = t + 0.5 * h
    for i in range(STATE_SIZE):
        s[STAGE, i] = s[STATE, i] + 0.5 * h * s[K1, i]
    if fitted is not None:
        appendages(rows.shapes, fitted, body, s, STAGE, 1, half, flow, w)
    derivative(body, s, STAGE, K2, half, flow, shapes, thrusters, forces, 1, wrenches, M_inv, held, work, R)
    for i in range(STATE_SIZE):
        s[STAGE, i] = s[STATE, i] + 0.5 * h * s[K2, i]
    if fitted is not None:
        appendages(rows.shapes, fitted, body, s, STAGE, 1, half, flow, w)
    derivative(body, s, STAGE, K3, half, flow, shapes, thrusters, forces, 1, wrenches, M_inv, held, work, R)
    for i in range(STATE_SIZE):
        s[STAGE, i] = s[STATE, i] + h * s[K3, i]
    if fitted is not None:
        appendages(rows.shapes, fitted, body, s, STAGE, 2, t + h, flow, w)
    derivative(body, s, STAGE, K4, t + h, flow, shapes, thrusters, forces, 2, wrenches, M_inv, held, work, R)
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
def _implicit(rows: Any, body: Any, t: float, h: float, flow: Array, held: float, w: Scratch, fitted: Any) -> None:
    """Rosenbrock-Euler: (M + h dD/dnu) delta_nu = h M nu_dot, then the pose by the new velocity."""
    shapes, thrusters, lags, wrenches = rows.shapes, rows.thrusters, rows.lags, rows.wrenches
    s, forces, M_inv, work, R = w.s, w.forces, w.M_inv, w.work, w.R
    first, count = body.thruster_first, body.thruster_count
    for k in range(count):
        thruster = thrusters[first + k]
        advance_lag(thruster, lags[thruster.lag], 0)
        forces[2, k] = advance_lag(thruster, lags[thruster.lag], 0)
    if fitted is not None:
        _advance_servos(fitted.servos, body, 0.5 * h, w)
        appendages(rows.shapes, fitted, body, s, STATE, 2, t + 0.5 * h, flow, w)
    derivative(body, s, STATE, K1, t + 0.5 * h, flow, shapes, thrusters, forces, 2, wrenches, M_inv, held, work, R)
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
    derivative(body, s, STAGE, K2, t + h, flow, shapes, thrusters, forces, 2, wrenches, M_inv, held, work, R)
    for i in range(7):
        s[STATE, i] += h * s[K2, i]
    for i in range(7, STATE_SIZE):
        s[STATE, i] = s[STAGE, i]
    _normalise(s)


@inlined
def step_body(rows: Any, fitted: Any, n: int, x: Array, flow: Array, t: float, dt: float, w: Scratch) -> float:
    """Carry body n from the state x (13) at t to t + dt without contact; w.s[STATE] receives the new state, lags and servos move on.

    `fitted` is None for a body without appendages, so that the compiler leaves out all that concerns them; see `step_fitted`.

    Returns:
        The submerged fraction that scaled M_A in the step; w.M_inv is the inverse inertia that goes with it.
    """
    body, shapes, thrusters, lags, wrenches = rows.bodies[n], rows.shapes, rows.thrusters, rows.lags, rows.wrenches
    s, forces, M_inv, work, R = w.s, w.forces, w.M_inv, w.work, w.R
    for i in range(STATE_SIZE):
        s[STATE, i] = x[i]
    held = _hold_inertia(rows.shapes, body, x, flow, t, dt, w)
    for k in range(body.thruster_count):
        thruster = thrusters[body.thruster_first + k]
        forces[0, k] = lagged(thruster, lags[thruster.lag])
    if fitted is not None:
        _present_appendages(rows, fitted, body, t, flow, w)
    derivative(body, s, STATE, K1, t, flow, shapes, thrusters, forces, 0, wrenches, M_inv, held, work, R)
    need = _damping_rate(body, s, flow, dt) * dt / STABLE
    level, steps = 0, 1
    while steps < need and level < MAX_LEVEL:
        level += 1
        steps *= 2
    if need > steps:
        _implicit(rows, body, t, dt, flow, held, w, fitted)
    else:
        h = dt / steps
        for k in range(steps):
            _rk4(rows, body, t + k * h, h, level, k == 0, flow, held, w, fitted)
    return held


@compiled
def step_fitted(rows: Any, fitted: Any, n: int, x: Array, flow: Array, t: float, dt: float, w: Scratch) -> float:
    """`step_body` of a body with appendages, whose rows are `fitted` (`layout.Fitted`)."""
    held = step_body(rows, fitted, n, x, flow, t, dt, w)
    _no_appendages(w)
    return held


@inlined
def step_any(rows: Any, fitted: Any, n: int, x: Array, flow: Array, t: float, dt: float, w: Scratch) -> None:
    """`step_body` of any body of a world, with its appendages if it has some."""
    if fitted is None:
        step_body(rows, None, n, x, flow, t, dt, w)
    elif rows.bodies[n].fitted != 0:
        step_fitted(rows, fitted, n, x, flow, t, dt, w)
    else:
        step_body(rows, None, n, x, flow, t, dt, w)


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
def advance(table: Array, t: float, dt: float) -> int:
    """Carry all bodies from t to t + dt, in place.

    Args:
        table: of the world's rows, states (n, 13) p_NB, q_NB, nu, and flows (`handles`); the water near each body is linear in place and
            time within the tick.
        t, dt: start and length of the tick, s.

    Returns:
        -1, or the row of the first body whose state is not finite or absurdly fast.
    """
    if is_fitted(table):
        return _advance(rows_at(table), fitted_at(table), state_at(table), flows_at(table), t, dt)
    return _advance(rows_at(table), None, state_at(table), flows_at(table), t, dt)


@compiled
def _advance(rows: Any, fitted: Any, state: Array, flows: Array, t: float, dt: float) -> int:
    """`fitted` is None for a world without appendages, so that the compiler leaves out all that concerns them."""
    thrusters = rows.thrusters
    w = scratch(thrusters.shape[0], servo_count(fitted))
    for k in range(thrusters.shape[0]):
        set_demand(thrusters[k], rows.tables)
    for n in range(rows.bodies.shape[0]):
        if rows.bodies[n].retired != 0:
            continue
        step_any(rows, fitted, n, state[n], flows[n], t, dt, w)
        if not keep_state(w.s, state[n]):
            return n
    return -1


@compiled
def rates_of_change(table: Array, t: float, nu_dot: Array, tau: Array) -> None:
    """Acceleration and applied wrench of all bodies at one instant, from the present lag states; changes no state.

    Args:
        table, t: as for `advance`.
        nu_dot: (n, 6) out, derivative of nu in B, m/s2 and rad/s2.
        tau: (n, 6) out, thrust plus prescribed wrench about the origin in B, N and N m.
    """
    if is_fitted(table):
        _rates_of_change(rows_at(table), fitted_at(table), state_at(table), flows_at(table), t, nu_dot, tau)
    else:
        _rates_of_change(rows_at(table), None, state_at(table), flows_at(table), t, nu_dot, tau)


@compiled
def _rates_of_change(rows: Any, fitted: Any, state: Array, flows: Array, t: float, nu_dot: Array, tau: Array) -> None:
    w = scratch(rows.thrusters.shape[0], servo_count(fitted))
    shapes, thrusters, lags, wrenches = rows.shapes, rows.thrusters, rows.lags, rows.wrenches
    s, forces, M_inv, work, R = w.s, w.forces, w.M_inv, w.work, w.R
    for n in range(rows.bodies.shape[0]):
        body = rows.bodies[n]
        if body.retired != 0:
            for i in range(6):
                nu_dot[n, i] = tau[n, i] = 0.0
            continue
        for i in range(STATE_SIZE):
            s[STATE, i] = state[n, i]
        held = _hold_inertia(rows.shapes, body, state[n], flows[n], t, 0.0, w)
        for k in range(body.thruster_count):
            thruster = thrusters[body.thruster_first + k]
            forces[0, k] = lagged(thruster, lags[thruster.lag])
        if fitted is not None:  # noqa: SIM102  # apart, so that the compiler leaves the branch out for None
            if body.fitted != 0:
                _present_appendages(rows, fitted, body, t, flows[n], w)
        derivative(body, s, STATE, K1, t, flows[n], shapes, thrusters, forces, 0, wrenches, M_inv, held, work, R)
        for i in range(6):
            nu_dot[n, i] = s[K1, 7 + i]
            tau[n, i] = w.work[EXTERNAL, i]
        _no_appendages(w)
