"""One tick of all bodies of a world in one compiled call, and their rates of change at an instant. `runge_kutta` steps a single body."""

from __future__ import annotations

from typing import Any

from uwserver.physics.dynamics.fossen import derivative
from uwserver.physics.dynamics.runge_kutta import hold_inertia, present_appendages, present_forces, step_body
from uwserver.physics.dynamics.scratch import ACTUATED, APPLIED, EXTERNAL, K1, PASSIVE, STATE
from uwserver.physics.dynamics.thruster import set_demand
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry, inlined
from uwserver.physics.kernel.handles import fitted_at, flows_at, model_at, scratch_at, state_at, team_at
from uwserver.physics.kernel.layout import STATE_SIZE, Model
from uwserver.physics.kernel.sharing import share

DIVERGED_SPEED = 1e6  # m/s or rad/s: long before numbers overflow

LEAST_BODIES = 6
"""Fewest bodies in a range that a thread steps: some 5 us."""
LEAST_RATES = 24
"""Fewest bodies in a range whose rates of change a thread finds."""


@compiled
def _no_appendages(w: Any) -> None:
    """Clear the rows of appendages, for the next body."""
    for i in range(6):
        w.work[ACTUATED, i] = w.work[PASSIVE, i] = 0.0


@inlined
def step_any(model: Model, fitted: Any, n: int, x: Array, flow: Array, t: float, dt: float, w: Any) -> None:
    """Step any body of a world as `step_body` does, and clear the rows of its appendages afterwards."""
    step_body(model, fitted, n, x, flow, t, dt, w)
    if fitted is not None:
        _no_appendages(w)


@compiled
def set_demands(model: Model, body: Any) -> None:
    """Set the demands of the thrusters of a body from their last commands."""
    for k in range(body.thruster_first, body.thruster_first + body.thruster_count):
        set_demand(model.thrusters[k], model.tables)


@compiled
def keep_state(s: Array, x: Array) -> bool:
    """Copy s[STATE] to x (13). Return False if it is not finite or absurdly fast."""
    sound = True
    for i in range(STATE_SIZE):
        value = s[STATE, i]
        x[i] = value
        # also false for NaN
        if not abs(value) < 1e12 or (i >= 7 and not abs(value) < DIVERGED_SPEED):
            sound = False
    return sound


@entry
def advance(table: Array, t: float, dt: float) -> int:
    """Move all bodies of a world without appendages from t to t + dt, in place.

    Args:
        table: table of the world's rows, states (n, 13) p_NB, q_NB, nu, and flows (`handles`); the water near each body is linear in place and
            time within the tick.
        t, dt: start and length of the tick, s.

    Returns:
        -1, or the row of the first body whose state is not finite or absurdly fast; all others have moved on.
    """
    return _advance(table, None, t, dt)


@entry
def advance_fitted(table: Array, t: float, dt: float) -> int:
    """Do what `advance` does, for a world where a body has appendages. It is a separate entry, as it takes twice as long to compile and most
    worlds have none."""
    return _advance(table, fitted_at(table), t, dt)


@compiled
def _advance(table: Array, fitted: Any, t: float, dt: float) -> int:
    """Move all bodies. `fitted` is None for a world without appendages, so that the compiler leaves out all code for them."""
    count, scratch = state_at(table).shape[0], scratch_at(table)
    for k in range(scratch.shape[0]):
        scratch[k].diverged = count
    share(team_at(table), _advance_range, (table, fitted, t, dt), count, LEAST_BODIES)
    first = count
    for k in range(scratch.shape[0]):
        first = min(first, scratch[k].diverged)
    return first if first < count else -1


@compiled
def _advance_range(first: int, end: int, me: int, table: Array, fitted: Any, t: float, dt: float) -> None:
    model, state, flows, w = model_at(table), state_at(table), flows_at(table), scratch_at(table)[me]
    for n in range(first, end):
        body = model.bodies[n]
        set_demands(model, body)
        if body.retired == 0:
            step_any(model, fitted, n, state[n], flows[n], t, dt, w)
            if not keep_state(w.s, state[n]):
                w.diverged = min(w.diverged, n)
        for i in range(6):
            body.acted[i] = body.external[i]
            body.external[i] = 0.0


@entry
def rates_of_change(table: Array, t: float, nu_dot: Array, tau: Array) -> None:
    """Find acceleration and applied wrench of all bodies of a world without appendages at one instant, from the present states of the lags. No
    state changes.

    Args:
        table, t: as for `advance`.
        nu_dot: (n, 6) out, derivative of nu in B, m/s2 and rad/s2.
        tau: (n, 6) out, thrust plus prescribed and external wrench about the origin in B, N and N m. The external one is that of the last
            tick.
    """
    _rates_of_change(table, None, t, nu_dot, tau)


@entry
def rates_of_change_fitted(table: Array, t: float, nu_dot: Array, tau: Array) -> None:
    """Do what `rates_of_change` does, for a world where a body has appendages."""
    _rates_of_change(table, fitted_at(table), t, nu_dot, tau)


@compiled
def _rates_of_change(table: Array, fitted: Any, t: float, nu_dot: Array, tau: Array) -> None:
    share(team_at(table), _rates_range, (table, fitted, t, nu_dot, tau), state_at(table).shape[0], LEAST_RATES)


@compiled
def _rates_range(first: int, end: int, me: int, table: Array, fitted: Any, t: float, nu_dot: Array, tau: Array) -> None:
    model, state, flows, w = model_at(table), state_at(table), flows_at(table), scratch_at(table)[me]
    for n in range(first, end):
        body = model.bodies[n]
        if body.retired != 0:
            for i in range(6):
                nu_dot[n, i] = tau[n, i] = 0.0
            continue
        for i in range(STATE_SIZE):
            w.s[STATE, i] = state[n, i]
        for i in range(6):
            w.work[EXTERNAL, i] = body.acted[i]
        held = hold_inertia(model.shapes, body, state[n], flows[n], t, 0.0, w)
        present_forces(model, body)
        if fitted is not None:
            present_appendages(model, fitted, body, flows[n], t, w)
        derivative(model, body, flows[n], t, held, STATE, K1, 0, w)
        for i in range(6):
            nu_dot[n, i] = w.s[K1, 7 + i]
            tau[n, i] = w.work[APPLIED, i]
        _no_appendages(w)
