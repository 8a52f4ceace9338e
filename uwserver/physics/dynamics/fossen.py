"""Fossen's equations for one body: the right-hand side that the integrator steps (compiled).

    M_RB nu_dot + C_RB(nu) nu + M_A nu_r_dot + C_A(nu_r) nu_r + D(nu_r) nu_r + g(eta) = tau        (Fossen 2011, eqs. 6.1 and 8.1)

about the body origin, with nu_r = nu - nu_c. The water does not turn: nu_c = [R^T v_c; 0], so nu_c_dot = [R^T dv_c/dt - w x nu_c; 0] in the
turning body frame, with dv_c/dt along the body's path. Accelerating water (waves, shear, a drifting current) has a pressure gradient, which
acts on a body as on the water that it displaces: the Froude-Krylov force rho V Du/Dt at r_b. Both Coriolis terms are in Kirchhoff form, from
the momenta p = M nu:  C(nu) nu = [w x p_1; v x p_1 + w x p_2]; they do no work by construction.

For a hull with strips (`strips`), in waves, the water turns too: nu_c = [v_c; w_c] is the rigid motion that fits the water along it best, and the
Froude-Krylov force has a moment of its own.
"""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.dynamics.immersion import depth_below, immersion, upward
from uwserver.physics.dynamics.scratch import (
    ACTUATED,
    APPLIED,
    CENTER,
    DU_DT,
    EXTERNAL,
    EXTRA,
    MOMENTUM,
    NU,
    NU_R,
    PASSIVE,
    PULL,
    STREAM,
    STREAM_RATE,
    TAU,
    UP,
    WATER,
)
from uwserver.physics.dynamics.strips import along_hull, extrapolate, mount_velocity
from uwserver.physics.dynamics.thruster import thrust
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, inlined, separate
from uwserver.physics.kernel.layout import (
    FLOW_GRADIENT,
    FLOW_KIND,
    FLOW_P,
    FLOW_T,
    FLOW_V,
    FLOW_V_T,
    NEAR_NOTHING,
    STEADY,
    Model,
)
from uwserver.physics.kernel.linear import add_force, rotation, to_body, to_world, velocity_at


@inlined
def _multiply_add(M: Array, form: int, work: Array, source: int, scale: float, target: int) -> None:
    """Add scale M (6, 6) work[source] to work[target]; `form` of M: 0 zero, 1 diagonal, 2 full."""
    if form == 1:
        for i in range(6):
            work[target, i] += scale * (M[i, i] * work[source, i])
    elif form == 2:
        v0, v1, v2 = work[source, 0], work[source, 1], work[source, 2]
        v3, v4, v5 = work[source, 3], work[source, 4], work[source, 5]
        for i in range(6):
            row = M[i, 0] * v0 + M[i, 1] * v1 + M[i, 2] * v2 + M[i, 3] * v3 + M[i, 4] * v4 + M[i, 5] * v5
            work[target, i] += scale * row


@compiled
def _subtract_coriolis(work: Array, velocity: int) -> None:
    """Subtract C(v) v from work[TAU], for the momentum in work[MOMENTUM] and the velocity in a row."""
    p0, p1, p2 = work[MOMENTUM, 0], work[MOMENTUM, 1], work[MOMENTUM, 2]
    p3, p4, p5 = work[MOMENTUM, 3], work[MOMENTUM, 4], work[MOMENTUM, 5]
    v0, v1, v2 = work[velocity, 0], work[velocity, 1], work[velocity, 2]
    v3, v4, v5 = work[velocity, 3], work[velocity, 4], work[velocity, 5]
    work[TAU, 0] -= v4 * p2 - v5 * p1
    work[TAU, 1] -= v5 * p0 - v3 * p2
    work[TAU, 2] -= v3 * p1 - v4 * p0
    work[TAU, 3] -= v1 * p2 - v2 * p1 + v4 * p5 - v5 * p4
    work[TAU, 4] -= v2 * p0 - v0 * p2 + v5 * p3 - v3 * p5
    work[TAU, 5] -= v0 * p1 - v1 * p0 + v3 * p4 - v4 * p3


@compiled
def _subtract_damping(body: Any, fraction: float, work: Array) -> None:
    """Subtract fraction (D_L nu_r + D_Q |nu_r| nu_r + |u_r| D_S nu_r) from work[TAU]."""
    _multiply_add(body.D_L, body.form_D_L, work, NU_R, -fraction, TAU)
    if body.form_D_Q != 0:
        for i in range(6):
            work[EXTRA, i] = abs(work[NU_R, i]) * work[NU_R, i]
        _multiply_add(body.D_Q, body.form_D_Q, work, EXTRA, -fraction, TAU)
    if body.form_D_S != 0:
        _multiply_add(body.D_S, body.form_D_S, work, NU_R, -fraction * abs(work[NU_R, 0]), TAU)


@inlined
def gravity_over_surface(body: Any, z: float) -> float:
    """Return gravity at z of N (m) over gravity at the surface."""
    return 1.0 + body.gravity_growth * max(0.0, z)


@compiled
def _add_restoring(body: Any, R: Array, fraction: float, gravity: float, work: Array) -> None:
    """Add to work[TAU] the weight at r_g and the buoyancy of the submerged fraction at work[CENTER] (B, m). Both act along the third row of R, which
    is z_N in B.

    `gravity` is that at the body over that at the surface.
    """
    zx, zy, zz = R[2, 0], R[2, 1], R[2, 2]
    W, B = gravity * body.weight, gravity * (fraction * body.buoyancy)
    work[TAU, 0] += (W - B) * zx
    work[TAU, 1] += (W - B) * zy
    work[TAU, 2] += (W - B) * zz
    lx = W * body.r_g[0] - B * work[CENTER, 0]
    ly = W * body.r_g[1] - B * work[CENTER, 1]
    lz = W * body.r_g[2] - B * work[CENTER, 2]
    work[TAU, 3] += ly * zz - lz * zy
    work[TAU, 4] += lz * zx - lx * zz
    work[TAU, 5] += lx * zy - ly * zx


@compiled
def _find_moving(body: Any, s: Array, source: int, t: float, flow: Array, R: Array, work: Array) -> None:
    """Find the water at the centre of buoyancy in N: work[WATER] = [velocity; its rate along the body's path], work[DU_DT] = its acceleration."""
    gradient = flow[FLOW_GRADIENT : FLOW_GRADIENT + 9].reshape((3, 3))
    place, velocity, rate = flow[FLOW_P : FLOW_P + 3], flow[FLOW_V : FLOW_V + 3], flow[FLOW_V_T : FLOW_V_T + 3]
    water, lapse = work[WATER], t - flow[FLOW_T]
    extrapolate(
        s, source, work[NU], R, body.r_b, place, velocity, rate, gradient, lapse, water[:3], water[3:], work[DU_DT]
    )


@inlined
def find_water(body: Any, s: Array, source: int, t: float, flow: Array, R: Array, work: Array) -> bool:
    """Write the water at the centre of buoyancy in N to work[WATER]. If it is not steady and uniform, write all that `_find_moving` gives, and
    return True."""
    moving = bool(flow[FLOW_KIND] != STEADY)
    if moving:
        _find_moving(body, s, source, t, flow, R, work)
    else:
        for i in range(3):
            work[WATER, i] = flow[FLOW_V + i]
    return moving


@compiled
def _add_inertia(body: Any, w: Any, source: int, scale: float, target: int) -> None:
    """Add scale M_A w.work[source] to w.work[target], with the M_A (6, 6) of `near_boundary` for a body near boundaries."""
    if body.near_form != NEAR_NOTHING:
        _multiply_add(w.M_A, body.form_M_A, w.work, source, scale, target)
    else:
        _multiply_add(body.M_A, body.form_M_A, w.work, source, scale, target)


@separate
def _add_change_of_mass(body: Any, w: Any, held: float) -> None:
    """Add to w.work[TAU] the terms by the change of M_A with depth (`near_boundary`), at r_b."""
    work, R = w.work, w.R
    nu_r, b = work[NU_R], body.r_b
    vx, vy, vz = velocity_at(nu_r, b[0], b[1], b[2])
    for i in range(6):
        work[EXTRA, i] = 0.0
    _multiply_add(w.M_A_z, body.form_M_A, work, NU_R, held, EXTRA)
    sinking, pull = R[2, 0] * vx + R[2, 1] * vy + R[2, 2] * vz, 0.0
    for i in range(6):
        pull += 0.5 * work[EXTRA, i] * nu_r[i]
        work[TAU, i] -= sinking * work[EXTRA, i]
    fx, fy, fz = pull * R[2, 0], pull * R[2, 1], pull * R[2, 2]
    add_force(work[TAU], b[0], b[1], b[2], fx, fy, fz)


@separate
def _subtract_special_coriolis(body: Any, w: Any, held: float) -> None:
    """Subtract C_A nu_r and the terms by the change with depth from w.work[TAU], for a body with strips or near boundaries. It is a function of
    its own, as few bodies have either."""
    work, striped = w.work, body.strip_count > 0
    _add_inertia(body, w, NU_R, held, MOMENTUM)
    if striped:  # the axes of the momentum turn with the body, not with the water
        for i in range(3, 6):
            work[NU_R, i] += work[STREAM, i]
    _subtract_coriolis(work, NU_R)
    if striped:
        for i in range(3, 6):
            work[NU_R, i] -= work[STREAM, i]
    if body.near_form != NEAR_NOTHING:
        _add_change_of_mass(body, w, held)


@separate
def _add_special_current(body: Any, w: Any, moving: bool, cx: float, cy: float, cz: float, held: float) -> None:
    """Add M_A nu_c_dot of such a body to w.work[TAU]."""
    if body.strip_count > 0:
        _add_inertia(body, w, STREAM_RATE, held, TAU)
    else:
        _find_current_rate(moving, w.R, cx, cy, cz, w.work)
        _add_inertia(body, w, EXTRA, held, TAU)


@inlined
def _find_current_rate(moving: bool, R: Array, cx: float, cy: float, cz: float, work: Array) -> None:
    """Write nu_c_dot to work[EXTRA], for the current (cx, cy, cz) in B."""
    nu3, nu4, nu5 = work[NU, 3], work[NU, 4], work[NU, 5]
    work[EXTRA, 0] = nu5 * cy - nu4 * cz
    work[EXTRA, 1] = nu3 * cz - nu5 * cx
    work[EXTRA, 2] = nu4 * cx - nu3 * cy
    work[EXTRA, 3] = work[EXTRA, 4] = work[EXTRA, 5] = 0.0
    if moving:
        for i in range(3):
            work[EXTRA, i] += R[0, i] * work[WATER, 3] + R[1, i] * work[WATER, 4] + R[2, i] * work[WATER, 5]


@compiled
def _add_froude_krylov(R: Array, displaced: float, work: Array) -> None:
    """Add displaced (kg) Du/Dt, acting at work[CENTER] (B, m), to work[TAU]."""
    ax, ay, az = to_body(R, work[DU_DT, 0], work[DU_DT, 1], work[DU_DT, 2])
    add_force(
        work[TAU], work[CENTER, 0], work[CENTER, 1], work[CENTER, 2], displaced * ax, displaced * ay, displaced * az
    )


@compiled
def _add_prescribed(row: Any, t: float, R: Array, work: Array) -> None:
    """Add bias + amplitude sin(omega t + phase) of one WRENCH row to work[TAU], at stage time t (s)."""
    for i in range(6):
        work[EXTRA, i] = row.bias[i]
    if row.harmonic != 0:
        for i in range(6):
            work[EXTRA, i] += row.amplitude[i] * math.sin(row.omega[i] * t + row.phase[i])
    if row.frame == 0:
        for i in range(6):
            work[TAU, i] += work[EXTRA, i]
    else:
        for i in range(3):
            work[TAU, i] += R[0, i] * work[EXTRA, 0] + R[1, i] * work[EXTRA, 1] + R[2, i] * work[EXTRA, 2]
            work[TAU, 3 + i] += R[0, i] * work[EXTRA, 3] + R[1, i] * work[EXTRA, 4] + R[2, i] * work[EXTRA, 5]


@compiled
def _add_contact(body: Any, s: Array, source: int, t: float, R: Array, work: Array) -> None:
    """Add the force and moment of the body's contacts to work[TAU]. They are given in N, the moment about N's origin, because contacts move on
    their own paths."""
    F, lapse = body.contact, t - body.contact[9]
    x, y, z = s[source, 0], s[source, 1], s[source, 2]
    mx = F[3] + lapse * F[6] - (y * F[2] - z * F[1])
    my = F[4] + lapse * F[7] - (z * F[0] - x * F[2])
    mz = F[5] + lapse * F[8] - (x * F[1] - y * F[0])
    for i in range(3):
        work[TAU, i] += R[0, i] * F[0] + R[1, i] * F[1] + R[2, i] * F[2]
        work[TAU, 3 + i] += R[0, i] * mx + R[1, i] * my + R[2, i] * mz


@inlined
def _add_thrusts(
    model: Model, body: Any, stage: int, depth: float, near_surface: bool, striped: bool, R: Array, work: Array
) -> None:
    """Add the wrench of the body's thrusters in B about the origin to work[TAU]. The sums are kept in local variables: in memory each addition
    would wait for the one before."""
    t0, t1, t2 = work[TAU, 0], work[TAU, 1], work[TAU, 2]
    t3, t4, t5 = work[TAU, 3], work[TAU, 4], work[TAU, 5]
    for k in range(body.thruster_first, body.thruster_first + body.thruster_count):
        if striped:
            r = model.thrusters[k].r
            vx, vy, vz = mount_velocity(body, model.strips, r[0], r[1], r[2], R, work)
            work[EXTRA, 0], work[EXTRA, 1], work[EXTRA, 2] = vx, vy, vz
        force = thrust(model.thrusters[k], model.forces[k, stage], depth, near_surface, striped, work)
        per_force = model.thrusters[k].per_force
        t0, t1, t2 = t0 + force * per_force[0], t1 + force * per_force[1], t2 + force * per_force[2]
        t3, t4, t5 = t3 + force * per_force[3], t4 + force * per_force[4], t5 + force * per_force[5]
    work[TAU, 0], work[TAU, 1], work[TAU, 2] = t0, t1, t2
    work[TAU, 3], work[TAU, 4], work[TAU, 5] = t3, t4, t5


@separate
def derivative(
    model: Model, body: Any, flow: Array, t: float, held: float, source: int, target: int, stage: int, w: Any
) -> None:
    """Write the state derivative of one body at one instant to w.s[target], from the state in w.s[source].

    Args:
        model: all rows of the world.
        body: BODY record.
        flow: (FLOW_SIZE) the water near the body.
        t: time of the instant, s.
        held: submerged fraction that scales M_A; it is constant within a step.
        source, target: rows of w.s.
        stage: column of model.forces, the lagged thrust of each thruster at t.
        w: SCRATCH record; M_inv goes with `held`, and rows ACTUATED, PASSIVE and EXTERNAL of its work are added to the forces. Afterwards row
            NU_R holds nu_r, row APPLIED the wrench of all actuators, the prescribed and the external one in B about the origin, and R is R_NB.
    """
    s, work, R = w.s, w.work, w.R
    rotation(s[source, 3], s[source, 4], s[source, 5], s[source, 6], R)
    for i in range(6):
        work[NU, i] = work[NU_R, i] = s[source, 7 + i]
        work[TAU, i] = work[ACTUATED, i]
        work[MOMENTUM, i] = 0.0
        if work[EXTERNAL, i] != 0.0:
            work[TAU, i] += work[EXTERNAL, i]
    striped = body.strip_count > 0
    moving = striped or find_water(body, s, source, t, flow, R, work)
    if striped:
        along_hull(body, model.strips, s, source, t, flow, R, work)
    cx, cy, cz = to_body(R, work[WATER, 0], work[WATER, 1], work[WATER, 2])
    if striped:
        for i in range(6):
            work[NU_R, i] -= work[STREAM, i]
    else:
        work[NU_R, 0] -= cx
        work[NU_R, 1] -= cy
        work[NU_R, 2] -= cz

    depth = depth_below(flow, s[source, 0], s[source, 1], s[source, 2], t)
    near_surface = body.shape_count > 0 and depth < body.radius
    fraction = 1.0
    for i in range(3):
        work[CENTER, i] = body.r_b[i]
    if near_surface:
        upward(flow, R, work[UP])
        fraction = immersion(body, model.shapes, depth, work[CENTER], work[UP : UP + 2, 0:3])
    _add_thrusts(model, body, stage, depth, near_surface, striped, R, work)
    for k in range(body.wrench_first, body.wrench_first + body.wrench_count):
        _add_prescribed(model.wrenches[k], t, R, work)
    for i in range(6):
        work[APPLIED, i] = work[TAU, i]
        work[TAU, i] += work[PASSIVE, i]
    if body.in_contact != 0:
        _add_contact(body, s, source, t, R, work)
    _add_restoring(body, R, fraction, gravity_over_surface(body, s[source, 2]), work)
    if moving:
        _add_froude_krylov(R, fraction * body.displaced, work)
    if striped:
        for i in range(3):
            work[TAU, 3 + i] += fraction * body.displaced * work[PULL, i]

    _multiply_add(body.M_RB, body.form_M_RB, work, NU, 1.0, MOMENTUM)
    _subtract_coriolis(work, NU)
    for i in range(6):
        work[MOMENTUM, i] = 0.0
    special = striped or body.near_form != NEAR_NOTHING
    if special:
        _subtract_special_coriolis(body, w, held)
    else:
        _multiply_add(body.M_A, body.form_M_A, work, NU_R, held, MOMENTUM)
        _subtract_coriolis(work, NU_R)
    _subtract_damping(body, fraction, work)
    if special:
        _add_special_current(body, w, moving, cx, cy, cz, held)
    elif moving or cx != 0.0 or cy != 0.0 or cz != 0.0:
        _find_current_rate(moving, R, cx, cy, cz, work)
        _multiply_add(body.M_A, body.form_M_A, work, EXTRA, held, TAU)

    for i in range(6):
        work[EXTRA, i] = 0.0
    _multiply_add(w.M_inv, max(body.form_M_RB, body.form_M_A), work, TAU, 1.0, EXTRA)
    s[target, 0], s[target, 1], s[target, 2] = to_world(R, work[NU, 0], work[NU, 1], work[NU, 2])
    for i in range(6):
        s[target, 7 + i] = work[EXTRA, i]
    nu3, nu4, nu5 = work[NU, 3], work[NU, 4], work[NU, 5]
    w, a, b, c = 0.5 * s[source, 3], 0.5 * s[source, 4], 0.5 * s[source, 5], 0.5 * s[source, 6]
    s[target, 3] = -a * nu3 - b * nu4 - c * nu5
    s[target, 4] = w * nu3 + b * nu5 - c * nu4
    s[target, 5] = w * nu4 - a * nu5 + c * nu3
    s[target, 6] = w * nu5 + a * nu4 - b * nu3
