"""One tick of bodies that touch (compiled): the free step as a trial, impulses at its start, the real step, and what is left at its end.

    1. predict: every body near a contact does the free RK4 step as a trial.
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
from typing import Any

import numpy as np

from uwserver.physics.contact.forces import Struck, apply_impulses, clear_contact
from uwserver.physics.contact.islands import fill_slots, find_islands
from uwserver.physics.contact.solver import (
    Constraints,
    add_response,
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
from uwserver.physics.kernel.rotation import product, rotation
from uwserver.physics.kernel.sharing import share

BOUNCE_SPEED = 0.01  # m/s: slower hits do not bounce, or a body at rest would tremble
SLOP = 1e-5  # m of penetration that is left alone; Bullet's own figure
RECOVERY = 0.2  # part of the penetration beyond that is recovered each tick
MAX_RECOVERY = 0.5  # m/s


@compiled
def predict(
    first: int, end: int, me: int,
    table: Array, model: Model, fitted: Any, bodies: Array, t: float, dt: float, predicted: Array, M_inv: Array,
) -> None:  # fmt: skip
    """The free step of some of `bodies`, as a trial; moves lags and servos on, so their rows in `model` and `fitted` must be copies."""
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
def _warm_start(key: Array, old_key: Array, old_impulse: Array, axes: Array, impulse: Array) -> None:
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


@entry
def strike(table: Array, contacts: Any, old_key: Array, old_impulse: Array, t: float, dt: float) -> Struck:
    """Stages 1 and 2 in a world without appendages: impulses at the start of the tick; the states receive the new velocities.

    Args:
        table: of the world, as for `integrator.advance`.
        contacts: `contacts.Contacts`.
        old_key, old_impulse: (j), (j, 3, in N) of the tick before, for the warm start.
        t, dt: start and length of the tick, s.
    """
    return _strike(table, None, contacts, old_key, old_impulse, t, dt)


@entry
def strike_fitted(table: Array, contacts: Any, old_key: Array, old_impulse: Array, t: float, dt: float) -> Struck:
    """`strike` for a world where a body has appendages."""
    present = fitted_at(table)
    trial = Fitted(
        present.servos.copy(), present.foils, present.propellers, present.weights, present.derivatives, present.hulls,
        present.values,
    )  # fmt: skip
    return _strike(table, trial, contacts, old_key, old_impulse, t, dt)


@compiled
def _strike(
    table: Array, fitted: Any, contacts: Any, old_key: Array, old_impulse: Array, t: float, dt: float
) -> Struck:
    """`fitted` has a copy of the servos, or is None for a world without appendages."""
    present, state = model_at(table), state_at(table)
    model = Model(
        present.bodies, present.shapes, present.thrusters.copy(), present.tables, present.lags, present.wrenches, present.forces,
        present.strips,
    )  # fmt: skip
    k = contacts.gap.shape[0]
    slot_a, slot_b = np.empty(k, np.int64), np.empty(k, np.int64)
    slot_of, bodies = np.full(state.shape[0], -1), np.empty(state.shape[0], np.int64)
    m = fill_slots(contacts.body_a, slot_of, bodies, 0, slot_a)
    m = fill_slots(contacts.body_b, slot_of, bodies, m, slot_b)
    bodies = bodies[:m].copy()
    order, bounds = np.empty(k, np.int64), np.empty(k + 1, np.int64)
    islands = find_islands(slot_a, slot_b, m, order, bounds)

    start, predicted, M_inv = state[bodies], np.empty((m, STATE_SIZE)), np.empty((m, 6, 6))
    share(team_at(table), predict, (table, model, fitted, bodies, t, dt, predicted, M_inv), m, LEAST_BODIES)

    axes, rows, gains = np.empty((k, 3, 3)), np.empty((k, 4, 3, 6)), np.empty((k, 2))
    for c in range(k):
        set_axes(contacts.normal[c], axes[c])
    constraints = Constraints(slot_a, slot_b, order, bounds[: islands + 1].copy(), axes, rows, gains)
    bias, R = np.empty((k, 3)), np.empty((3, 3))
    nu, nu_free = start[:, 7:], predicted[:, 7:]
    set_jacobians(constraints, predicted, contacts.point, R)
    _set_velocities(constraints, nu_free, bias)
    set_jacobians(constraints, start, contacts.point, R)
    set_responses(constraints, M_inv)

    impulse, change = np.zeros((k, 3)), np.zeros((m, 6))
    bounced, frozen = np.zeros(k, np.bool_), np.zeros(k, np.bool_)
    _warm_start(contacts.key, old_key, old_impulse, axes, impulse)
    _set_targets(contacts, constraints, nu, dt, bias, bounced, impulse)
    for c in range(k):
        add_response(rows, c, impulse[c], slot_a[c], slot_b[c], change)
    for i in range(islands):
        solve_island(constraints, i, bias, contacts.friction, frozen, impulse, change)
    _drop_untouched(slot_a, slot_b, impulse, change)
    struck = Struck(bodies, start, M_inv, constraints, impulse, bounced, change)
    apply_impulses(model.bodies, struck, contacts.point, state, dt)
    return struck


@compiled
def _set_velocities(constraints: Constraints, nu: Array, bias: Array) -> None:
    """bias (k, 3) = w of all contacts at the velocities nu (m, 6)."""
    for c in range(bias.shape[0]):
        for d in range(3):
            bias[c, d] = relative_velocity(constraints.rows, c, d, nu, constraints.slot_a[c], constraints.slot_b[c])


@compiled
def _set_targets(
    contacts: Any, constraints: Constraints, nu: Array, dt: float, bias: Array, bounced: Array, impulse: Array
) -> None:
    """What each contact asks of the velocity: at the start of the tick where it bounces, at the end where it holds.

    Args:
        nu: (m, 6) at the start of the tick.
        bias: (k, 3) in: w at the end of the free step; out: as `solve_island` has it.
        bounced: (k) out.
        impulse: (k, 3) warm start, in and out.
    """
    rows, slot_a, slot_b = constraints.rows, constraints.slot_a, constraints.slot_b
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


@entry
def settle(table: Array, struck: Struck, contacts: Any, dt: float, impulse_N: Array, contact_nu_dot: Array) -> None:
    """Stage 4, after the real step: the rest of the impulses, poses, recovery.

    Args:
        table: of the world; what contacts did to its BODY rows is cleared, and its states become those at the end of the tick.
        impulse_N: (k, 3) out, impulse on body a in N, N s.
        contact_nu_dot: (n, 6) out, mean acceleration in B by contacts in the tick; zeros for the others.
    """
    rows, state, constraints = model_at(table).bodies, state_at(table), struck.constraints
    k, m = contacts.gap.shape[0], struck.bodies.shape[0]
    now = state[struck.bodies]
    for i in range(m):
        clear_contact(rows[struck.bodies[i]])
    bias, R, rest = np.empty((k, 3)), np.empty((3, 3)), np.zeros((m, 6))
    nu = now[:, 7:]
    set_jacobians(constraints, now, contacts.point, R)
    set_responses(constraints, struck.M_inv)
    _set_velocities(constraints, nu, bias)
    for c in range(k):
        bias[c, 0] += max(0.0, contacts.gap[c]) / dt
    for i in range(constraints.bounds.shape[0] - 1):
        if _any_impulse(constraints, i, struck.impulse):
            solve_island(constraints, i, bias, contacts.friction, struck.bounced, struck.impulse, rest)
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
    slot_a, slot_b, axes = struck.constraints.slot_a, struck.constraints.slot_b, struck.constraints.axes
    for c in range(slot_a.shape[0]):
        for i in range(3):
            impulse_N[c, i] = 0.0
            for d in range(3):
                impulse_N[c, i] += axes[c, d, i] * struck.impulse[c, d]
        if struck.impulse[c, 0] > 0.0 and not struck.bounced[c]:
            held[slot_a[c]] = True
            if slot_b[c] >= 0:
                held[slot_b[c]] = True


@compiled
def _any_impulse(constraints: Constraints, island: int, impulse: Array) -> bool:
    found = False
    for k in range(constraints.bounds[island], constraints.bounds[island + 1]):
        found = found or impulse[constraints.order[k], 0] > 0.0
    return found


@compiled
def _move(start: Array, velocity: Array, dt: float, R: Array, x: Array) -> None:
    """Pose of x (13) = pose of `start` carried on for dt at `velocity` (6), whose linear part is in the axes of x."""
    rotation(x[3], x[4], x[5], x[6], R)
    for i in range(3):
        x[i] = start[i] + dt * (R[i, 0] * velocity[0] + R[i, 1] * velocity[1] + R[i, 2] * velocity[2])
    rate = math.sqrt(velocity[3] ** 2 + velocity[4] ** 2 + velocity[5] ** 2)
    half = 0.5 * dt * rate
    s = 0.5 * dt if half < 1e-8 else math.sin(half) / rate
    w, a, b, c = math.cos(half), s * velocity[3], s * velocity[4], s * velocity[5]
    x[3], x[4], x[5], x[6] = product(start[3], start[4], start[5], start[6], w, a, b, c)
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
    for i in range(struck.constraints.bounds.shape[0] - 1):
        solve_island(struck.constraints, i, bias, smooth, free, impulse, displacement)
    for i in range(m):
        moves = False
        for j in range(6):
            moves = moves or displacement[i, j] != 0.0
        if moves:
            _move(now[i].copy(), displacement[i], dt, R, now[i])
