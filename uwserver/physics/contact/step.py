"""One tick of bodies that touch (compiled): the free step as a trial, impulses at its start, the real step, and what is left at its end.

    1. predict: every body near a contact takes the free RK4 step as a trial.
    2. strike:  impulses, so that the velocity at the end of the tick satisfies the contacts. They act as a force over the tick, so a body
                at rest stays at rest within it too; a hit that bounces is reversed at its start. Bodies without an impulse keep their
                free step, bit for bit.
    3. The real RK4 step of all bodies (`integrator.advance`), with them: drag, Munk moment and thrust act on the true motion.
    4. settle:  the small rest that the change of those forces leaves is removed at the new pose. A body that stays in contact moves by the
                velocity it ends with, so that one at rest stays where it is; one that bounced keeps its RK4 pose. Penetration is
                recovered by a displacement that never enters the velocity (split impulse), so it adds no kinetic energy.

All impulses act through the full 6x6 inverse of M_RB + held M_A. Bodies that touch each other form islands, solved one by one: a contact
elsewhere in the world changes nothing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.contact.forces import act, let_go
from uwserver.physics.contact.islands import fill_slots, find_islands
from uwserver.physics.contact.solver import (
    J_A,
    J_B,
    push_all,
    relative_velocity,
    set_axes,
    set_gains,
    set_jacobian,
    set_response,
    solve_rows,
)
from uwserver.physics.dynamics.fossen import rotation
from uwserver.physics.dynamics.integrator import STATE, scratch, servo_count, step_any
from uwserver.physics.dynamics.thruster import set_demand
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.layout import STATE_SIZE

Array = Any  # numpy array inside compiled code

BOUNCE_SPEED = 0.01  # m/s: slower hits do not bounce, or a body at rest would tremble
SLOP = 1e-5  # m of penetration that is left alone; Bullet's own figure
RECOVERY = 0.2  # part of the penetration beyond that is taken back each tick
MAX_RECOVERY = 0.5  # m/s


class Struck(NamedTuple):
    """What `strike` hands to `settle`, for k contacts of m bodies.

    Attributes:
        bodies: (m) rows of the bodies near a contact.
        start: (m, 13) their states at the start of the tick.
        M_inv: (m, 6, 6).
        slot_a, slot_b: (k) places of the contacts' bodies in `bodies`; -1 for what does not move.
        order, bounds: contacts island by island; island i is order[bounds[i]:bounds[i + 1]].
        axes: (k, 3, 3) normal and tangents in N.
        rows, gains: of the solver.
        impulse: (k, 3) along the axes, N s.
        bounced: (k) whether the contact was a hit that bounces.
        change: (m, 6) of nu by all impulses of the tick.
    """

    bodies: Array
    start: Array
    M_inv: Array
    slot_a: Array
    slot_b: Array
    order: Array
    bounds: Array
    axes: Array
    rows: Array
    gains: Array
    impulse: Array
    bounced: Array
    change: Array


@compiled
def predict(
    rows: Any,
    fitted: Any,
    bodies: Array,
    state: Array,
    flows: Array,
    t: float,
    dt: float,
    predicted: Array,
    M_inv: Array,
) -> None:
    """The free step of some bodies, as a trial; moves lags and servos on, so their rows must be copies."""
    thrusters = rows.thrusters
    w = scratch(thrusters.shape[0], servo_count(fitted))
    for k in range(thrusters.shape[0]):
        set_demand(thrusters[k], rows.tables)
    for i in range(bodies.shape[0]):
        n = bodies[i]
        step_any(rows, fitted, n, state[n], flows[n], t, dt, w)
        for j in range(STATE_SIZE):
            predicted[i, j] = w.s[STATE, j]
        for j in range(6):
            for m in range(6):
                M_inv[i, j, m] = w.M_inv[j, m]


@compiled
def _warm(key: Array, old_key: Array, old_impulse: Array, axes: Array, impulse: Array) -> None:
    """impulse (k, 3) along the axes from the tick before, where the same contact was there."""
    old = old_key.shape[0]
    for c in range(key.shape[0]):
        for j in range(old):
            o = (c + j) % old  # the order seldom changes
            if old_key[o] == key[c]:
                for d in range(3):
                    impulse[c, d] = 0.0
                    for i in range(3):
                        impulse[c, d] += axes[c, d, i] * old_impulse[o, i]
                impulse[c, 0] = max(0.0, impulse[c, 0])
                break


@compiled
def _set_jacobians(
    state: Array, point: Array, axes: Array, slot_a: Array, slot_b: Array, R: Array, rows: Array
) -> None:
    """Jacobians of all contacts at the poses in `state` (m, 13)."""
    for c in range(point.shape[0]):
        set_jacobian(state[slot_a[c]], point[c], axes[c], 1.0, R, rows, c, J_A)
        if slot_b[c] >= 0:
            set_jacobian(state[slot_b[c]], point[c], axes[c], -1.0, R, rows, c, J_B)


@compiled
def _set_responses(M_inv: Array, slot_a: Array, slot_b: Array, rows: Array, gains: Array) -> None:
    for c in range(slot_a.shape[0]):
        set_response(M_inv, slot_a[c], rows, c, J_A)
        if slot_b[c] >= 0:
            set_response(M_inv, slot_b[c], rows, c, J_B)
        set_gains(rows, c, slot_b[c] >= 0, gains[c])


@compiled
def strike(
    rows: Any,
    fitted: Any,
    state: Array,
    flows: Array,
    contacts: Any,
    old_key: Array,
    old_impulse: Array,
    t: float,
    dt: float,
) -> Struck:
    """Stages 1 and 2: impulses at the start of the tick; `state` receives the new velocities.

    Args:
        rows, fitted: with copies of the rows whose lags and servos a step moves on.
        contacts: `contact.Contacts`.
        old_key, old_impulse: (j), (j, 3, in N) of the tick before, for the warm start.
        others: as for `integrator.advance`.
    """
    k = contacts.gap.shape[0]
    slot_a, slot_b = np.empty(k, np.int64), np.empty(k, np.int64)
    slot_of, bodies = np.full(state.shape[0], -1), np.empty(state.shape[0], np.int64)
    m = fill_slots(contacts.body_a, slot_of, bodies, 0, slot_a)
    m = fill_slots(contacts.body_b, slot_of, bodies, m, slot_b)
    bodies = bodies[:m].copy()
    order, bounds = np.empty(k, np.int64), np.empty(k + 1, np.int64)
    islands = find_islands(slot_a, slot_b, m, order, bounds)

    start, predicted, M_inv = state[bodies], np.empty((m, STATE_SIZE)), np.empty((m, 6, 6))
    predict(rows, fitted, bodies, state, flows, t, dt, predicted, M_inv)

    axes, solver, gains = np.empty((k, 3, 3)), np.empty((k, 4, 3, 6)), np.empty((k, 2))
    bias, R = np.empty((k, 3)), np.empty((3, 3))
    for c in range(k):
        set_axes(contacts.normal[c], axes[c])
    nu, nu_free = start[:, 7:], predicted[:, 7:]
    _set_jacobians(predicted, contacts.point, axes, slot_a, slot_b, R, solver)
    for c in range(k):
        for d in range(3):
            bias[c, d] = relative_velocity(solver, c, d, nu_free, slot_a[c], slot_b[c])
    _set_jacobians(start, contacts.point, axes, slot_a, slot_b, R, solver)
    _set_responses(M_inv, slot_a, slot_b, solver, gains)

    impulse, change = np.zeros((k, 3)), np.zeros((m, 6))
    bounced, frozen = np.zeros(k, np.bool_), np.zeros(k, np.bool_)
    _warm(contacts.key, old_key, old_impulse, axes, impulse)
    _aim(contacts, slot_a, slot_b, solver, nu, dt, bias, bounced, impulse)
    for c in range(k):
        push_all(solver, c, impulse[c], slot_a[c], slot_b[c], change)
    for i in range(islands):
        solve_rows(
            order, bounds[i], bounds[i + 1], slot_a, slot_b, solver, gains, bias, contacts.friction, frozen, impulse, change
        )  # fmt: skip
    _drop_untouched(slot_a, slot_b, impulse, change)
    struck = Struck(
        bodies, start, M_inv, slot_a, slot_b, order, bounds[: islands + 1].copy(), axes, solver, gains, impulse, bounced, change
    )  # fmt: skip
    act(rows.bodies, struck, contacts.point, state, dt)
    return struck


@compiled
def _aim(
    contacts: Any, slot_a: Array, slot_b: Array, rows: Array, nu: Array, dt: float, bias: Array, bounced: Array, impulse: Array
) -> None:  # fmt: skip
    """What each contact asks of the velocity: at the start of the tick where it bounces, at the end where it holds.

    Args:
        nu: (m, 6) at the start of the tick.
        bias: (k, 3) in: w at the end of the free step; out: as `solve_rows` takes it.
        bounced: (k) out.
        impulse: (k, 3) warm start, in and out.
    """
    for c in range(contacts.gap.shape[0]):
        approach = relative_velocity(rows, c, 0, nu, slot_a[c], slot_b[c])
        e, gap = contacts.restitution[c], contacts.gap[c]
        if e > 0.0 and approach < -BOUNCE_SPEED and gap + dt * bias[c, 0] < 0.0:
            bounced[c] = True
            bias[c, 0] = (1.0 + e) * approach
            for d in range(1, 3):
                bias[c, d] = relative_velocity(rows, c, d, nu, slot_a[c], slot_b[c])
            impulse[c] = 0.0
        else:
            bias[c, 0] += max(0.0, gap) / dt
        if contacts.friction[c] <= 0.0:
            impulse[c, 1] = impulse[c, 2] = 0.0


@compiled
def _drop_untouched(slot_a: Array, slot_b: Array, impulse: Array, change: Array) -> None:
    """Clear what rounding left in the velocity changes of bodies without any impulse."""
    touched = np.zeros(change.shape[0], np.bool_)
    for c in range(slot_a.shape[0]):
        if impulse[c, 0] > 0.0:
            touched[slot_a[c]] = True
            if slot_b[c] >= 0:
                touched[slot_b[c]] = True
    for i in range(change.shape[0]):
        if not touched[i]:
            for j in range(6):
                change[i, j] = 0.0


@compiled
def settle(
    rows: Array, struck: Struck, state: Array, contacts: Any, dt: float, impulse_N: Array, contact_nu_dot: Array
) -> None:
    """Stage 4, after the real step: the rest of the impulses, poses, recovery.

    Args:
        rows: BODY rows; what acted on them in the tick is taken off.
        state: (n, 13) after the step; in place.
        impulse_N: (k, 3) out, impulse on body a in N, N s.
        contact_nu_dot: (n, 6) out, mean acceleration in B by contacts in the tick; zeros for the others.
    """
    k, m = contacts.gap.shape[0], struck.bodies.shape[0]
    slot_a, slot_b, solver, bounds = struck.slot_a, struck.slot_b, struck.rows, struck.bounds
    now = state[struck.bodies]
    for i in range(m):
        let_go(rows[struck.bodies[i]])
    bias, R, rest = np.empty((k, 3)), np.empty((3, 3)), np.zeros((m, 6))
    nu = now[:, 7:]
    _set_jacobians(now, contacts.point, struck.axes, slot_a, slot_b, R, solver)
    _set_responses(struck.M_inv, slot_a, slot_b, solver, struck.gains)
    for c in range(k):
        for d in range(3):
            bias[c, d] = relative_velocity(solver, c, d, nu, slot_a[c], slot_b[c])
        bias[c, 0] += max(0.0, contacts.gap[c]) / dt
    for i in range(bounds.shape[0] - 1):
        if _any_impulse(struck.order, bounds[i], bounds[i + 1], struck.impulse):
            solve_rows(
                struck.order, bounds[i], bounds[i + 1], slot_a, slot_b, solver, struck.gains, bias, contacts.friction, struck.bounced,
                struck.impulse, rest,
            )  # fmt: skip
    held = np.zeros(m, np.bool_)
    _sum_up(struck, impulse_N, held)
    contact_nu_dot[:, :] = 0.0
    for i in range(m):
        for j in range(6):
            now[i, 7 + j] += rest[i, j]
            contact_nu_dot[struck.bodies[i], j] = (struck.change[i, j] + rest[i, j]) / dt
        if held[i]:
            _move(struck.start[i], nu[i], dt, R, now[i])
    _recover(struck, contacts, dt, R, now)
    for i in range(m):
        state[struck.bodies[i]] = now[i]


@compiled
def _sum_up(struck: Struck, impulse_N: Array, held: Array) -> None:
    """Impulses in N, and which bodies (m) stay in contact."""
    for c in range(struck.slot_a.shape[0]):
        for i in range(3):
            impulse_N[c, i] = 0.0
            for d in range(3):
                impulse_N[c, i] += struck.axes[c, d, i] * struck.impulse[c, d]
        if struck.impulse[c, 0] > 0.0 and not struck.bounced[c]:
            held[struck.slot_a[c]] = True
            if struck.slot_b[c] >= 0:
                held[struck.slot_b[c]] = True


@compiled
def _any_impulse(order: Array, first: int, end: int, impulse: Array) -> bool:
    found = False
    for k in range(first, end):
        found = found or impulse[order[k], 0] > 0.0
    return found


@compiled
def _move(start: Array, velocity: Array, dt: float, R: Array, x: Array) -> None:
    """Pose of x (13) = pose of `start` carried on for dt at `velocity` (6), whose linear part is in the axes of x."""
    rotation(x[3], x[4], x[5], x[6], R)
    q0, q1, q2, q3 = start[3], start[4], start[5], start[6]
    for i in range(3):
        x[i] = start[i] + dt * (R[i, 0] * velocity[0] + R[i, 1] * velocity[1] + R[i, 2] * velocity[2])
    rate = math.sqrt(velocity[3] ** 2 + velocity[4] ** 2 + velocity[5] ** 2)
    half = 0.5 * dt * rate
    s = 0.5 * dt if half < 1e-8 else math.sin(half) / rate
    w, a, b, c = math.cos(half), s * velocity[3], s * velocity[4], s * velocity[5]
    x[3] = q0 * w - q1 * a - q2 * b - q3 * c
    x[4] = q0 * a + q1 * w + q2 * c - q3 * b
    x[5] = q0 * b - q1 * c + q2 * w + q3 * a
    x[6] = q0 * c + q1 * b - q2 * a + q3 * w
    norm = math.sqrt(x[3] ** 2 + x[4] ** 2 + x[5] ** 2 + x[6] ** 2)
    for i in range(3, 7):
        x[i] /= norm


@compiled
def _recover(struck: Struck, contacts: Any, dt: float, R: Array, now: Array) -> None:
    """Displace bodies out of each other, by part of the penetration a tick."""
    k, m = contacts.gap.shape[0], struck.bodies.shape[0]
    bias, deep = np.zeros((k, 3)), False
    for c in range(k):
        gap = contacts.gap[c]
        if gap < -SLOP:
            bias[c, 0] = max(RECOVERY * (gap + SLOP) / dt, -MAX_RECOVERY)
            deep = True
        else:
            bias[c, 0] = max(0.0, gap) / dt
    if not deep:
        return
    impulse, displacement = np.zeros((k, 3)), np.zeros((m, 6))
    smooth, free = np.zeros(k), np.zeros(k, np.bool_)
    bounds = struck.bounds
    for i in range(bounds.shape[0] - 1):
        solve_rows(
            struck.order, bounds[i], bounds[i + 1], struck.slot_a, struck.slot_b, struck.rows, struck.gains, bias, smooth, free, impulse,
            displacement,
        )  # fmt: skip
    for i in range(m):
        moves = False
        for j in range(6):
            moves = moves or displacement[i, j] != 0.0
        if moves:
            _move(now[i].copy(), displacement[i], dt, R, now[i])
