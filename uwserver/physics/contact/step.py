"""One tick of bodies that touch (compiled): hits at its start, the free step as a trial, the real step, and the rest at its end.

    1. strike: hits first. They are impulses at the start of the tick, such that no gap closes further within the tick than it is open. Hits that
        bounce reverse the approach. Then every body near a contact makes the free RK4 step as a trial, and holding impulses are chosen such that
        the velocity at the end of the tick satisfies the contacts. They act as a force over the tick, so a body at rest also stays at rest within
        the tick. Bodies without an impulse keep their free step, bit for bit.
    2. The real RK4 step of all bodies (`integrator.advance`), with these forces: drag, Munk moment and thrust act on the true motion.
    3. finish_contacts: the forces of the real step differ slightly from those of the trial. The small rest is removed at the new pose.
        Penetration is recovered by a displacement that never enters the velocity (split impulse), so it adds no kinetic energy.

All impulses act through the full 6x6 inverse of M_RB + held M_A, on both bodies at one point of N. A contact moves within the tick as it moved in the
last one (`forces.set_drift`): that of a ball rolls along with it, that of a corner stays in its place. Bodies that touch each other form islands,
which are solved one by one, so that a contact elsewhere in the world changes nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.contact.forces import Struck, apply_forces, clear_contact, set_drift
from uwserver.physics.contact.recovery import recover
from uwserver.physics.contact.solver import (
    Constraints,
    add_response,
    fill_slots,
    find_islands,
    relative_velocity,
    set_axes,
    set_jacobians,
    set_responses,
    solve_island,
)
from uwserver.physics.dynamics.integrator import LEAST_BODIES, set_demands, step_any
from uwserver.physics.dynamics.scratch import STATE
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import fitted_at, flows_at, model_at, scratch_at, state_at, team_at
from uwserver.physics.kernel.layout import STATE_SIZE, Fitted, Model
from uwserver.physics.kernel.linear import rotation
from uwserver.physics.kernel.sharing import share

BOUNCE_SPEED = 0.01  # m/s: slower hits do not bounce, or a body at rest would tremble


@compiled
def predict(
    first: int, end: int, me: int,
    table: Array, model: Model, fitted: Any, bodies: Array, t: float, dt: float, predicted: Array, M_inv: Array,
) -> None:  # fmt: skip
    """Make the free step of some of `bodies` as a trial. It advances lags and servos, so their rows in `model` and `fitted` must be copies."""
    state, flows, w = state_at(table), flows_at(table), scratch_at(table)[me]
    for i in range(first, end):
        n = bodies[i]
        set_demands(model, model.bodies[n])
        step_any(model, fitted, n, state[n], flows[n], t, dt, w)
        for j in range(STATE_SIZE):
            predicted[i, j] = w.s[STATE, j]
        for j in range(6):
            for m in range(6):
                M_inv[i, j, m] = w.M_inv[j, m]


@compiled
def _warm_start(contacts: Any, old_key: Array, old_hold: Array, axes: Array, hold: Array) -> None:
    """Write the holding impulses of the tick before to hold (k, 3), along the axes, for contacts that existed then. `hold` must be zero before."""
    old = old_key.shape[0]
    for c in range(hold.shape[0]):
        for j in range(old):
            o = (c + j) % old  # begins at the same place, as the order seldom changes
            if old_key[o] == contacts.key[c]:
                for d in range(1 if contacts.friction[c] <= 0.0 else 3):
                    for i in range(3):
                        hold[c, d] += axes[c, d, i] * old_hold[o, i]
                hold[c, 0] = max(0.0, hold[c, 0])
                break


@entry
def strike(
    table: Array, contacts: Any, old_key: Array, old_point: Array, old_hold: Array, t: float, dt: float
) -> Struck:
    """Do stage 1 in a world without appendages: the states receive the velocities after the hits, the BODY rows the forces that hold.

    Args:
        table: table of the world, as for `integrator.advance`.
        contacts: `contacts.Contacts`.
        old_key, old_point, old_hold: (j), (j, 3), (j, 3, in N) of the tick before; its holding impulses are the first guess for this tick.
        t, dt: start and length of the tick, s.
    """
    return _strike(table, None, contacts, old_key, old_point, old_hold, t, dt)


@entry
def strike_fitted(
    table: Array, contacts: Any, old_key: Array, old_point: Array, old_hold: Array, t: float, dt: float
) -> Struck:
    """Do what `strike` does, for a world where a body has appendages."""
    present = fitted_at(table)
    trial = Fitted(
        present.servos.copy(), present.foils, present.propellers, present.weights, present.derivatives, present.hulls,
        present.values,
    )  # fmt: skip
    return _strike(table, trial, contacts, old_key, old_point, old_hold, t, dt)


@compiled
def _strike(
    table: Array, fitted: Any, contacts: Any, old_key: Array, old_point: Array, old_hold: Array, t: float, dt: float
) -> Struck:
    """Do stage 1. `fitted` has a copy of the servos, or is None for a world without appendages."""
    present, state = model_at(table), state_at(table)
    model = Model(
        present.bodies, present.shapes, present.thrusters.copy(), present.tables, present.lags, present.wrenches, present.forces,
        present.strips,
    )  # fmt: skip
    bodies, constraints = _connect(contacts, state.shape[0])
    rows, point = model.bodies, contacts.point
    k, m = contacts.gap.shape[0], bodies.shape[0]
    start, predicted, M_inv = state[bodies], np.empty((m, STATE_SIZE)), np.empty((m, 6, 6))
    R, drift, warm = np.empty((3, 3)), np.empty((k, 3)), np.zeros((k, 3))
    _warm_start(contacts, old_key, old_hold, constraints.axes, warm)
    set_drift(contacts, constraints, start, old_key, old_point, dt, R, drift)
    apply_forces(rows, bodies, constraints, point, drift, warm, t, dt)
    share(team_at(table), predict, (table, model, fitted, bodies, t, dt, predicted, M_inv), m, LEAST_BODIES)
    for i in range(m):
        clear_contact(rows[bodies[i]])

    set_jacobians(constraints, start, point, constraints.rows, R)
    set_responses(constraints, M_inv)
    hit, hold, jump, change = np.zeros((k, 3)), warm.copy(), np.zeros((m, 6)), np.zeros((m, 6))
    bounced, late = np.zeros(k, np.bool_), np.full(k, -1.0)
    if _hit(contacts, constraints, start[:, 7:], predicted[:, 7:], dt, hit, bounced, late):
        _sum_up(constraints, hit, jump)
        _follow(start, predicted, jump, dt, R)
        set_drift(contacts, constraints, start, old_key, old_point, dt, R, drift)

    bias, ahead = np.empty((k, 3)), np.empty((k, 4, 3, 6))
    set_jacobians(constraints, predicted, point + drift, ahead, R)
    _set_velocities(constraints, ahead, predicted[:, 7:], bias)
    _leave_open(contacts.gap, dt, bias)
    for i in range(constraints.bounds.shape[0] - 1):
        _solve_held(constraints, i, bias, contacts.friction, bounced, hold, change)
        _await_touch(contacts, constraints, i, bias, jump, warm, late, bounced, hold)
    _sum_up(constraints, hold, change)
    apply_forces(rows, bodies, constraints, point, drift, hold, t, dt)
    for i in range(m):
        for j in range(6):
            state[bodies[i], 7 + j] += jump[i, j]
            change[i, j] += jump[i, j]
    return Struck(bodies, M_inv, constraints, drift, hit, hold, bounced, change)


@compiled
def _connect(contacts: Any, count: int) -> tuple[Array, Constraints]:
    """Return the rows of the bodies at contacts, of `count` bodies in the world, and the constraints between them, whose rows are not set yet."""
    k = contacts.gap.shape[0]
    slot_a, slot_b = np.empty(k, np.int64), np.empty(k, np.int64)
    slot_of, bodies = np.full(count, -1), np.empty(count, np.int64)
    m = fill_slots(contacts.body_a, slot_of, bodies, 0, slot_a)
    m = fill_slots(contacts.body_b, slot_of, bodies, m, slot_b)
    order, bounds = np.empty(k, np.int64), np.empty(k + 1, np.int64)
    islands = find_islands(slot_a, slot_b, m, order, bounds)
    axes = np.empty((k, 3, 3))
    for c in range(k):
        set_axes(contacts.normal[c], axes[c])
    rows, gains = np.empty((k, 4, 3, 6)), np.empty((k, 2))
    return bodies[:m].copy(), Constraints(slot_a, slot_b, order, bounds[: islands + 1].copy(), axes, rows, gains)


@compiled
def _hit(
    contacts: Any, constraints: Constraints, nu: Array, nu_free: Array, dt: float, hit: Array, bounced: Array, late: Array
) -> bool:  # fmt: skip
    """Find the impulses at the start of the tick of contacts that would close within it. Return whether there are any.

    Args:
        contacts, constraints: as for `strike`.
        nu, nu_free: (m, 6) at the start of the tick, and at the end of the trial.
        dt: s.
        hit: (k, 3) out, impulses; zeros in.
        bounced: (k) out, whether a hit bounces.
        late: (k) out, when within the tick a hit that does not bounce comes, as a part of it; -1 for a slow hit, or if there is none.
    """
    k, rows = contacts.gap.shape[0], constraints.rows
    bias = np.empty((k, 3))
    _set_velocities(constraints, rows, nu, bias)
    closes = False
    for c in range(k):
        approach, e, gap = bias[c, 0], contacts.restitution[c], contacts.gap[c]
        if approach < -BOUNCE_SPEED:
            later = relative_velocity(rows, c, 0, nu_free, constraints.slot_a[c], constraints.slot_b[c])
            if gap + dt * min(approach, later) < 0.0:
                bounced[c] = e > 0.0
                late[c] = -1.0 if bounced[c] else min(1.0, -max(0.0, gap) / (dt * approach))
        bias[c, 0] += e * approach if bounced[c] else max(0.0, gap) / dt
        closes = closes or bias[c, 0] < 0.0
    if closes:
        frozen = np.zeros(k, np.bool_)
        jump = np.zeros(nu.shape)
        for i in range(constraints.bounds.shape[0] - 1):
            solve_island(constraints, i, bias, contacts.friction, frozen, hit, jump)
    return closes


@compiled
def _solve_held(
    constraints: Constraints, island: int, bias: Array, friction: Array, apart: Array, hold: Array, change: Array
) -> None:
    """Find the impulses `hold` (k, 3) of the force over the tick, none in contacts that are `apart` (k). The effect of their values at the start
    is part of the bias."""
    for k in range(constraints.bounds[island], constraints.bounds[island + 1]):
        c = constraints.order[k]
        if apart[c]:
            for d in range(3):
                hold[c, d] = -hold[c, d]
            add_response(constraints.rows, c, hold[c], constraints.slot_a[c], constraints.slot_b[c], change)
            hold[c] = 0.0
    solve_island(constraints, island, bias, friction, apart, hold, change)


@compiled
def _await_touch(
    contacts: Any, constraints: Constraints, island: int, bias: Array, jump: Array, warm: Array, late: Array, bounced: Array,
    hold: Array,
) -> None:  # fmt: skip
    """If a hit comes within the tick, let the earlier forces hold until then: `hold` becomes the mean over the tick.

    The hit itself is divided between the start and the end of the tick by its time within it. So a body that rocks from one edge to another is
    carried by the first until the second touches. `finish_contacts` must leave the island as it is, so its contacts become `bounced`.
    """
    order, bounds = constraints.order, constraints.bounds
    first = 2.0
    for k in range(bounds[island], bounds[island + 1]):
        if late[order[k]] >= 0.0:
            first = min(first, late[order[k]])
    if first == 0.0 or first > 1.0:
        return
    before, bias_before, change = warm.copy(), bias.copy(), np.zeros(jump.shape)
    apart = bounced.copy()
    for k in range(bounds[island], bounds[island + 1]):
        c = order[k]
        apart[c] = bounced[c] or late[c] >= 0.0
        for d in range(3):
            bias_before[c, d] -= relative_velocity(
                constraints.rows, c, d, jump, constraints.slot_a[c], constraints.slot_b[c]
            )
    _solve_held(constraints, island, bias_before, contacts.friction, apart, before, change)
    for k in range(bounds[island], bounds[island + 1]):
        c = order[k]
        bounced[c] = True
        for d in range(3):
            hold[c, d] += first * (before[c, d] - hold[c, d])


@compiled
def _follow(start: Array, predicted: Array, jump: Array, dt: float, R: Array) -> None:
    """Apply the change of velocity by the hits to the states (m, 13) at the start and the end of the free step, and the displacement that it
    causes to the latter."""
    for i in range(start.shape[0]):
        rotation(start[i, 3], start[i, 4], start[i, 5], start[i, 6], R)
        for j in range(3):
            predicted[i, j] += dt * (R[j, 0] * jump[i, 0] + R[j, 1] * jump[i, 1] + R[j, 2] * jump[i, 2])
        for j in range(6):
            start[i, 7 + j] += jump[i, j]
            predicted[i, 7 + j] += jump[i, j]


@compiled
def _set_velocities(constraints: Constraints, rows: Array, nu: Array, bias: Array) -> None:
    """Write w of all contacts at the velocities nu (m, 6) to bias (k, 3)."""
    for c in range(bias.shape[0]):
        for d in range(3):
            bias[c, d] = relative_velocity(rows, c, d, nu, constraints.slot_a[c], constraints.slot_b[c])


@compiled
def _leave_open(gap: Array, dt: float, bias: Array) -> None:
    """Allow each contact to close its gap within the tick."""
    for c in range(bias.shape[0]):
        bias[c, 0] += max(0.0, gap[c]) / dt


@compiled
def _sum_up(constraints: Constraints, impulse: Array, change: Array) -> None:
    """Write the change of nu by impulses (k, 3) to change (m, 6)."""
    change[:, :] = 0.0
    for c in range(impulse.shape[0]):
        add_response(constraints.rows, c, impulse[c], constraints.slot_a[c], constraints.slot_b[c], change)


@entry
def finish_contacts(
    table: Array, struck: Struck, contacts: Any, dt: float, impulse_N: Array, hold_N: Array, contact_nu_dot: Array
) -> None:
    """Do stage 3, after the real step: the rest of the impulses, and the recovery of penetration.

    Args:
        table: table of the world; the contact forces in its BODY rows are cleared, and its states become those at the end of the tick.
        impulse_N: (k, 3) out, impulse on body a in N, N s.
        hold_N: (k, 3) out, the part of it that was no hit.
        contact_nu_dot: (n, 6) out, mean acceleration in B by contacts in the tick; zeros for bodies without contacts.
    """
    rows, state, constraints = model_at(table).bodies, state_at(table), struck.constraints
    k, m = contacts.gap.shape[0], struck.bodies.shape[0]
    now = state[struck.bodies]
    for i in range(m):
        clear_contact(rows[struck.bodies[i]])
    bias, R, rest = np.empty((k, 3)), np.empty((3, 3)), np.zeros((m, 6))
    set_jacobians(constraints, now, contacts.point + struck.drift, constraints.rows, R)
    set_responses(constraints, struck.M_inv)
    _set_velocities(constraints, constraints.rows, now[:, 7:], bias)
    _leave_open(contacts.gap, dt, bias)
    for i in range(constraints.bounds.shape[0] - 1):
        if _any_impulse(struck, i):
            solve_island(constraints, i, bias, contacts.friction, struck.final, struck.hold, rest)
    for c in range(k):
        for j in range(3):
            hit = hold = 0.0
            for d in range(3):
                hit += constraints.axes[c, d, j] * struck.hit[c, d]
                hold += constraints.axes[c, d, j] * struck.hold[c, d]
            impulse_N[c, j], hold_N[c, j] = hit + hold, hold
    contact_nu_dot[:, :] = 0.0
    for i in range(m):
        for j in range(6):
            now[i, 7 + j] += rest[i, j]
            contact_nu_dot[struck.bodies[i], j] = (struck.change[i, j] + rest[i, j]) / dt
    recover(constraints, struck.M_inv, contacts.gap, dt, now)
    for i in range(m):
        state[struck.bodies[i]] = now[i]


@compiled
def _any_impulse(struck: Struck, island: int) -> bool:
    found = False
    for k in range(struck.constraints.bounds[island], struck.constraints.bounds[island + 1]):
        c = struck.constraints.order[k]
        found = found or struck.hit[c, 0] > 0.0 or struck.hold[c, 0] > 0.0
    return found
