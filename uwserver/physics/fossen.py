"""Fossen's equations for one body: the right-hand side that the integrator steps (compiled).

    M_RB nu_dot + C_RB(nu) nu + M_A nu_r_dot + C_A(nu_r) nu_r + D(nu_r) nu_r + g(eta) = tau        (Fossen 2011, eqs. 6.1 and 8.1)

about the body origin, with nu_r = nu - nu_c. The current is irrotational: nu_c = [R^T v_c; 0], so nu_c_dot = [-w x nu_c; 0] in the
turning body frame. Both Coriolis terms are in Kirchhoff form, from the momenta p = M nu:  C(nu) nu = [w x p_1; v x p_1 + w x p_2]; they do no
work by construction.
"""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.compiled import compiled
from uwserver.physics.immersion import immersion
from uwserver.physics.thrust import add_thrust

Array = Any  # numpy array inside compiled code


@compiled
def rotation(x: Array, R: Array) -> None:
    """R_NB (3, 3) of the quaternion in a state row; exact for any norm, so that a Runge-Kutta stage needs no normalisation."""
    w, a, b, c = x[3], x[4], x[5], x[6]
    s = 2.0 / (w * w + a * a + b * b + c * c)
    R[0, 0] = 1.0 - s * (b * b + c * c)
    R[0, 1] = s * (a * b - w * c)
    R[0, 2] = s * (a * c + w * b)
    R[1, 0] = s * (a * b + w * c)
    R[1, 1] = 1.0 - s * (a * a + c * c)
    R[1, 2] = s * (b * c - w * a)
    R[2, 0] = s * (a * c - w * b)
    R[2, 1] = s * (b * c + w * a)
    R[2, 2] = 1.0 - s * (a * a + b * b)


@compiled
def _multiply_add(M: Array, v: Array, scale: float, out: Array) -> None:
    """out (6) += scale M (6, 6) v (6)."""
    v0, v1, v2, v3, v4, v5 = v[0], v[1], v[2], v[3], v[4], v[5]
    for i in range(6):
        out[i] += scale * (M[i, 0] * v0 + M[i, 1] * v1 + M[i, 2] * v2 + M[i, 3] * v3 + M[i, 4] * v4 + M[i, 5] * v5)


@compiled
def _subtract_coriolis(p: Array, v: Array, tau: Array) -> None:
    """tau (6) -= C(v) v for momentum p (6) and velocity v (6)."""
    tau[0] -= v[4] * p[2] - v[5] * p[1]
    tau[1] -= v[5] * p[0] - v[3] * p[2]
    tau[2] -= v[3] * p[1] - v[4] * p[0]
    tau[3] -= v[1] * p[2] - v[2] * p[1] + v[4] * p[5] - v[5] * p[4]
    tau[4] -= v[2] * p[0] - v[0] * p[2] + v[5] * p[3] - v[3] * p[5]
    tau[5] -= v[0] * p[1] - v[1] * p[0] + v[3] * p[4] - v[4] * p[3]


@compiled
def _subtract_damping(body: Any, nu_r: Array, fraction: float, tau: Array, magnified: Array) -> None:
    """tau (6) -= fraction (D_L nu_r + D_Q |nu_r| nu_r + |u_r| D_S nu_r)."""
    _multiply_add(body.D_L, nu_r, -fraction, tau)
    if body.has_D_Q == 1:
        for i in range(6):
            tau[i] -= fraction * body.D_Q[i, i] * abs(nu_r[i]) * nu_r[i]
    elif body.has_D_Q == 2:
        for i in range(6):
            magnified[i] = abs(nu_r[i]) * nu_r[i]
        _multiply_add(body.D_Q, magnified, -fraction, tau)
    if body.has_D_S != 0:
        _multiply_add(body.D_S, nu_r, -fraction * abs(nu_r[0]), tau)


@compiled
def _add_restoring(body: Any, R: Array, buoyancy: float, center: Array, tau: Array) -> None:
    """tau (6) += weight at r_g and `buoyancy` (N) at `center` (3, B); both along the third row of R, which is z_N in B."""
    zx, zy, zz = R[2, 0], R[2, 1], R[2, 2]
    W, B, g = body.weight, buoyancy, body.r_g
    tau[0] += (W - B) * zx
    tau[1] += (W - B) * zy
    tau[2] += (W - B) * zz
    lx, ly, lz = W * g[0] - B * center[0], W * g[1] - B * center[1], W * g[2] - B * center[2]
    tau[3] += ly * zz - lz * zy
    tau[4] += lz * zx - lx * zz
    tau[5] += lx * zy - ly * zx


@compiled
def _add_prescribed(row: Any, t: float, R: Array, tau: Array) -> None:
    """tau (6) += bias + amplitude sin(omega t + phase) of one WRENCH row, at stage time t (s)."""
    w0, w1, w2 = row.bias[0], row.bias[1], row.bias[2]
    w3, w4, w5 = row.bias[3], row.bias[4], row.bias[5]
    if row.harmonic != 0:
        a, o, p = row.amplitude, row.omega, row.phase
        w0 += a[0] * math.sin(o[0] * t + p[0])
        w1 += a[1] * math.sin(o[1] * t + p[1])
        w2 += a[2] * math.sin(o[2] * t + p[2])
        w3 += a[3] * math.sin(o[3] * t + p[3])
        w4 += a[4] * math.sin(o[4] * t + p[4])
        w5 += a[5] * math.sin(o[5] * t + p[5])
    if row.frame == 0:
        tau[0] += w0
        tau[1] += w1
        tau[2] += w2
        tau[3] += w3
        tau[4] += w4
        tau[5] += w5
    else:
        for i in range(3):
            tau[i] += R[0, i] * w0 + R[1, i] * w1 + R[2, i] * w2
            tau[3 + i] += R[0, i] * w3 + R[1, i] * w4 + R[2, i] * w5


@compiled
def derivative(
    body: Any,
    x: Array,
    t: float,
    current: Array,
    shapes: Array,
    thrusters: Array,
    forces: Array,
    wrenches: Array,
    M_inv: Array,
    held: float,
    work: Array,
    R: Array,
    dx: Array,
    external: Array,
) -> None:
    """State derivative of one body at one instant.

    Args:
        body: BODY record.
        x: (13) state row, p_NB q_NB nu.
        t: time of the instant, s.
        current: (3) water velocity in N, m/s.
        shapes, thrusters, wrenches: all SHAPE, THRUSTER and WRENCH rows of the world.
        forces: lagged thrust of each of the body's thrusters at t, N.
        M_inv: (6, 6) inverse of M_RB + held M_A.
        held: submerged fraction that scales M_A, held within a step.
        work: (6, 6) scratch.
        R: (3, 3) out, R_NB.
        dx: (13) out.
        external: (6) out, thrust plus prescribed wrench in B about the origin.
    """
    rotation(x, R)
    nu, nu_r, p, tau, extra = x[7:13], work[0], work[1], work[2], work[3]
    cx = R[0, 0] * current[0] + R[1, 0] * current[1] + R[2, 0] * current[2]
    cy = R[0, 1] * current[0] + R[1, 1] * current[1] + R[2, 1] * current[2]
    cz = R[0, 2] * current[0] + R[1, 2] * current[1] + R[2, 2] * current[2]
    for i in range(6):
        nu_r[i] = nu[i]
        tau[i] = p[i] = 0.0
    nu_r[0] -= cx
    nu_r[1] -= cy
    nu_r[2] -= cz

    center = extra[0:3]
    fraction = immersion(body, shapes, x[2], R, center, work[4:6, 0:3])
    near_surface = body.shape_count > 0 and x[2] < body.radius
    for k in range(body.thruster_count):
        add_thrust(thrusters[body.thruster_first + k], forces[k], nu_r, x[2], R, near_surface, tau)
    for k in range(body.wrench_first, body.wrench_first + body.wrench_count):
        _add_prescribed(wrenches[k], t, R, tau)
    for i in range(6):
        external[i] = tau[i]
    _add_restoring(body, R, fraction * body.buoyancy, center, tau)

    _multiply_add(body.M_RB, nu, 1.0, p)
    _subtract_coriolis(p, nu, tau)
    for i in range(6):
        p[i] = 0.0
    _multiply_add(body.M_A, nu_r, held, p)
    _subtract_coriolis(p, nu_r, tau)
    _subtract_damping(body, nu_r, fraction, tau, extra)
    # + M_A nu_c_dot with nu_c_dot = [-w x nu_c; 0]
    extra[0] = nu[5] * cy - nu[4] * cz
    extra[1] = nu[3] * cz - nu[5] * cx
    extra[2] = nu[4] * cx - nu[3] * cy
    extra[3] = extra[4] = extra[5] = 0.0
    _multiply_add(body.M_A, extra, held, tau)

    for i in range(3):
        dx[i] = R[i, 0] * nu[0] + R[i, 1] * nu[1] + R[i, 2] * nu[2]
        dx[7 + i] = dx[10 + i] = 0.0
    w, a, b, c = 0.5 * x[3], 0.5 * x[4], 0.5 * x[5], 0.5 * x[6]
    dx[3] = -a * nu[3] - b * nu[4] - c * nu[5]
    dx[4] = w * nu[3] + b * nu[5] - c * nu[4]
    dx[5] = w * nu[4] - a * nu[5] + c * nu[3]
    dx[6] = w * nu[5] + a * nu[4] - b * nu[3]
    _multiply_add(M_inv, tau, 1.0, dx[7:13])
