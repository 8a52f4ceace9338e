"""One tick of one body (compiled): RK4 with sub-steps, and a linearly implicit fallback for a stiff body.

RK4 is stable while rate * dt < 2.78. Sub-steps keep rate * dt / n below 1.5, where `rate` bounds the fastest damping rate at the present velocity and
at the one to which the present acceleration leads (`params.damping_rates`). A body that would need more than 16 sub-steps is stepped by the
Rosenbrock-Euler rule instead, with the Jacobian of the damping: first order, and stable at any step.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.physics.dynamics.appendage_forces import advance_servo
from uwserver.physics.dynamics.appendages import appendages
from uwserver.physics.dynamics.fossen import derivative
from uwserver.physics.dynamics.immersion import depth_below, immersion, upward
from uwserver.physics.dynamics.near_boundary import set_near_mass
from uwserver.physics.dynamics.scratch import EXTERNAL, K1, K2, K3, K4, NU_R, STAGE, STATE, STREAM
from uwserver.physics.dynamics.thruster import advance_lag, lagged
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, inlined
from uwserver.physics.kernel.layout import FLOW_PLANE, FLOW_V, NEAR_NOTHING, STATE_SIZE, Model
from uwserver.physics.kernel.linear import rotation, solve, to_world

MAX_LEVEL = 4
STABLE = 1.5


@compiled
def _damping_rate(body: Any, s: Array, work: Array, flow: Array, dt: float) -> float:
    """Return an upper bound of the fastest damping rate, 1/s, in a tick that starts at s[STATE] with the derivative s[K1].

    Quadratic damping has no rate at rest, so for a light body under a sudden force the speed at the end of the tick counts.
    """
    speed = math.sqrt(flow[FLOW_V] ** 2 + flow[FLOW_V + 1] ** 2 + flow[FLOW_V + 2] ** 2)
    rate = float(body.rate_L)
    for j in range(6):
        nu = s[STATE, 7 + j]
        reached = max(abs(nu), abs(nu + dt * s[K1, 7 + j]))
        if j < 3:
            reached += speed
        elif body.strip_count > 0:
            reached += abs(work[STREAM, j])
        rate += body.rate_Q[j] * reached
        if j == 0:
            rate += body.rate_S * reached
    return rate


@compiled
def hold_inertia(shapes: Array, body: Any, x: Array, flow: Array, t: float, dt: float, w: Any) -> float:
    """Return the submerged fraction that holds in a step, and write the inverse inertia for it to w.M_inv.

    The fraction is that after half a step. With the one at the start, which always lags behind, a bobbing body would gain energy.
    """
    fraction = 1.0
    reach = body.radius + dt * (abs(x[7]) + abs(x[8]) + abs(x[9]) + abs(flow[FLOW_PLANE + 3]))
    near_surface = body.shape_count > 0 and depth_below(flow, x[0], x[1], x[2], t) < reach
    near = body.near_form != NEAR_NOTHING
    if near_surface or near:
        R, half = w.R, 0.5 * dt
        rotation(x[3], x[4], x[5], x[6], R)
        north, east, down = to_world(R, x[7], x[8], x[9])
        on_x, on_y, on_z = x[0] + half * north, x[1] + half * east, x[2] + half * down
        if near:
            set_near_mass(body, on_x, on_y, on_z, t + half, flow, w)
        if near_surface:
            upward(flow, R, w.small[0])
            fraction = immersion(body, shapes, depth_below(flow, on_x, on_y, on_z, t + half), w.small[2], w.small)
    if fraction == 1.0 and not near:
        for i in range(6):
            for j in range(6):
                w.M_inv[i, j] = body.M_inv[i, j]
    else:
        M = body.M_RB + fraction * (w.M_A if near else body.M_A)
        for i in range(6):
            for j in range(6):
                w.M_inv[i, j] = 1.0 if i == j else 0.0
        solve(M, w.M_inv)
    return fraction


@compiled
def _advance_servos(fitted: Any, body: Any, half: float) -> None:
    """Write the values of the body's servos now, after `half` (s) and after twice that; the servos advance to the last value."""
    for k in range(body.servo_first, body.servo_first + body.servo_count):
        servo, values = fitted.servos[k], fitted.values
        values[k, 0] = servo.value
        values[k, 1] = advance_servo(servo, half)
        values[k, 2] = advance_servo(servo, half)


@compiled
def present_appendages(model: Model, fitted: Any, body: Any, flow: Array, t: float, w: Any) -> None:
    """Write the wrench of the body's appendages at w.s[STATE], for the present values of its servos, to w.work."""
    for k in range(body.servo_first, body.servo_first + body.servo_count):
        fitted.values[k, 0] = fitted.servos[k].value
    appendages(model, fitted, body, flow, t, STATE, 0, w)


@compiled
def present_forces(model: Model, body: Any) -> None:
    """Write the thrust of the body's thrusters for the present states of their lags, as that of the first stage."""
    for k in range(body.thruster_first, body.thruster_first + body.thruster_count):
        model.forces[k, 0] = lagged(model.thrusters[k], model.lags[model.thrusters[k].lag])


@compiled
def _stage(
    model: Model, fitted: Any, body: Any, flow: Array, t: float, ahead: float, held: float, slope: int, target: int, stage: int, w: Any
) -> None:  # fmt: skip
    """Find the derivative w.s[target] at the time t, in the state that is `ahead` s on from w.s[STATE] along the slope w.s[slope]; `stage` is the
    column of the forces of thrusters and the values of servos at t."""
    for i in range(STATE_SIZE):
        w.s[STAGE, i] = w.s[STATE, i] + ahead * w.s[slope, i]
    if fitted is not None:
        appendages(model, fitted, body, flow, t, STAGE, stage, w)
    derivative(model, body, flow, t, held, STAGE, target, stage, w)


@inlined
def _rk4(
    model: Model,
    fitted: Any,
    body: Any,
    flow: Array,
    t: float,
    h: float,
    held: float,
    level: int,
    begun: bool,
    w: Any,
) -> None:
    """Make one classical Runge-Kutta step of length h of w.s[STATE], in place. If `begun`, model.forces[:, 0] and w.s[K1] are set already.

    The lag of the thrusters does not depend on the body, so its exact values at the three stage times are used.
    """
    s, forces = w.s, model.forces
    for k in range(body.thruster_first, body.thruster_first + body.thruster_count):
        thruster = model.thrusters[k]
        lag = model.lags[thruster.lag]
        if not begun:
            forces[k, 0] = lagged(thruster, lag)
        forces[k, 1] = advance_lag(thruster, lag, level)
        forces[k, 2] = advance_lag(thruster, lag, level)
    if fitted is not None:
        _advance_servos(fitted, body, 0.5 * h)
    if not begun:
        if fitted is not None:
            appendages(model, fitted, body, flow, t, STATE, 0, w)
        derivative(model, body, flow, t, held, STATE, K1, 0, w)
    half = t + 0.5 * h
    _stage(model, fitted, body, flow, half, 0.5 * h, held, K1, K2, 1, w)
    _stage(model, fitted, body, flow, half, 0.5 * h, held, K2, K3, 1, w)
    _stage(model, fitted, body, flow, t + h, h, held, K3, K4, 2, w)
    for i in range(STATE_SIZE):
        s[STATE, i] += h / 6.0 * (s[K1, i] + 2.0 * (s[K2, i] + s[K3, i]) + s[K4, i])
    _normalise(s)


@compiled
def _normalise(s: Array) -> None:
    """Scale the quaternion of s[STATE] to unit length."""
    n = math.sqrt(s[STATE, 3] ** 2 + s[STATE, 4] ** 2 + s[STATE, 5] ** 2 + s[STATE, 6] ** 2)
    for i in range(3, 7):
        s[STATE, i] /= n


@compiled
def _implicit(model: Model, fitted: Any, body: Any, flow: Array, t: float, h: float, held: float, w: Any) -> None:
    """Make a Rosenbrock-Euler step: (M + h dD/dnu) delta_nu = h M nu_dot, then the pose by the new velocity."""
    s, work = w.s, w.work
    for k in range(body.thruster_first, body.thruster_first + body.thruster_count):
        thruster = model.thrusters[k]
        advance_lag(thruster, model.lags[thruster.lag], 0)
        model.forces[k, 2] = advance_lag(thruster, model.lags[thruster.lag], 0)
    if fitted is not None:
        _advance_servos(fitted, body, 0.5 * h)
        appendages(model, fitted, body, flow, t + 0.5 * h, STATE, 2, w)
    derivative(model, body, flow, t + 0.5 * h, held, STATE, K1, 2, w)
    speed = abs(work[NU_R, 0])
    A = body.M_RB + held * (w.M_A if body.near_form != NEAR_NOTHING else body.M_A)
    delta = np.zeros((6, 1))
    for i in range(6):
        for j in range(6):
            delta[i, 0] += A[i, j] * s[K1, 7 + j]
    for i in range(6):
        for j in range(6):
            slope = body.D_L[i, j] + 2.0 * body.D_Q[i, j] * abs(work[NU_R, j]) + body.D_S[i, j] * speed
            A[i, j] += h * held * slope
    # d(|u| D u)/du = 2 D |u|; the other derivatives by u are left out, as they could make A singular.
    A[0, 0] += h * held * body.D_S[0, 0] * speed
    solve(A, delta)
    for i in range(STATE_SIZE):
        s[STAGE, i] = s[STATE, i]
    for i in range(6):
        s[STAGE, 7 + i] += h * delta[i, 0]
    derivative(model, body, flow, t + h, held, STAGE, K2, 2, w)
    for i in range(7):
        s[STATE, i] += h * s[K2, i]
    for i in range(7, STATE_SIZE):
        s[STATE, i] = s[STAGE, i]
    _normalise(s)


@inlined
def step_body(model: Model, fitted: Any, n: int, x: Array, flow: Array, t: float, dt: float, w: Any) -> float:
    """Step body n without contact from the state x (13) at t to t + dt. w.s[STATE] receives the new state; lags and servos advance.

    `fitted` is None in a world without appendages, so that the compiler leaves out all that concerns them; see `step_any`.

    Returns:
        The submerged fraction that scaled M_A in the step; w.M_inv is the inverse inertia that goes with it.
    """
    body = model.bodies[n]
    for i in range(STATE_SIZE):
        w.s[STATE, i] = x[i]
    for i in range(6):
        w.work[EXTERNAL, i] = body.external[i]
    held = hold_inertia(model.shapes, body, x, flow, t, dt, w)
    present_forces(model, body)
    if fitted is not None:
        present_appendages(model, fitted, body, flow, t, w)
    derivative(model, body, flow, t, held, STATE, K1, 0, w)
    need = _damping_rate(body, w.s, w.work, flow, dt) * dt / STABLE
    level, steps = 0, 1
    while steps < need and level < MAX_LEVEL:
        level += 1
        steps *= 2
    if need > steps:
        _implicit(model, fitted, body, flow, t, dt, held, w)
    else:
        h = dt / steps
        for k in range(steps):
            _rk4(model, fitted, body, flow, t + k * h, h, held, level, k == 0, w)
    return held
