"""Moving water that is not uniform and steady, evaluated at points and for all bodies of a world (compiled).

Uniform part, depth profiles and linear waves add up and do not affect each other. Above the still water level profiles and waves keep their value at
that level, where linear theory ends.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.kernel import elementary
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at, flows_at, state_at, team_at
from uwserver.physics.kernel.layout import (
    FLOW_KIND,
    FLOW_P,
    FLOW_PLANE,
    FLOW_T,
    FLOW_V,
    MOVING,
    NU,
    WAVE_AMPLITUDE,
    WAVE_DEPTH,
    WAVE_K,
    WAVE_KX,
    WAVE_KY,
    WAVE_OMEGA,
    WAVE_PHASE,
    WAVY,
    WORLD,
)  # fmt: skip
from uwserver.physics.kernel.linear import rotation, velocity_at
from uwserver.physics.kernel.sharing import share

_sines_and_cosines, _exponentials = elementary.sines_and_cosines.made(), elementary.exponentials.made()
bodies_at, strips_at = array_at(WORLD, "bodies"), array_at(WORLD, "strips")

# A row of water at a point: velocity (3), its partial derivative by time (3), its gradient (3, 3; row i: derivatives of component i),
# elevation, its slopes along x and y and its rate, and the dynamic pressure as a head (m).
V, V_T, GRADIENT, ELEVATION, SLOPE, ELEVATION_T, HEAD = 0, 3, 6, 15, 16, 18, 19
POINT_SIZE = 20

LEAST_FLOWS = 16
"""Fewest bodies in a range for which a thread finds the water: 5 us and more, with a few waves."""


@compiled
def _add_profiles(profiles: Array, z: float, point: Array) -> None:
    """Add the piecewise cubic profiles (m, 15) at depth z (m) to the water at a point."""
    for n in range(profiles.shape[0]):
        if profiles[n, 0] <= z < profiles[n, 1]:
            s = z - profiles[n, 2]
            for i in range(3):
                c = 3 + 4 * i
                c1, c2, c3 = profiles[n, c + 1], profiles[n, c + 2], profiles[n, c + 3]
                point[V + i] += profiles[n, c] + s * (c1 + s * (c2 + s * c3))
                point[GRADIENT + 3 * i + 2] += c1 + s * (2.0 * c2 + s * 3.0 * c3)


@compiled
def _fall_off(waves: Array, z: float, along: Array, across: Array, head: Array, work: Array) -> None:
    """Write the factors by which each wave has decayed at depth z (m): those of the velocities along and across the surface, and of the head."""
    n, is_deep = len(waves), True
    for i in range(n):
        below = min(max(z, 0.0), waves[i, WAVE_DEPTH])
        along[i], is_deep = -waves[i, WAVE_K] * below, is_deep and waves[i, WAVE_DEPTH] == np.inf
    _exponentials(along, work[0])
    across[:], head[:] = along, along
    if is_deep:
        return
    # cosh k(h - z) and sinh k(h - z) over sinh kh, cosh k(h - z) over cosh kh, in a form that does not overflow.
    image, bottom = work[1], work[2]
    for i in range(n):
        k, h = waves[i, WAVE_K], waves[i, WAVE_DEPTH]
        image[i], bottom[i] = -2.0 * k * (h - min(max(z, 0.0), h)), -2.0 * k * h
    _exponentials(image, work[0])
    _exponentials(bottom, work[0])
    for i in range(n):
        along[i] *= (1.0 + image[i]) / (1.0 - bottom[i])
        across[i] *= (1.0 - image[i]) / (1.0 - bottom[i])
        head[i] *= (1.0 + image[i]) / (1.0 + bottom[i])


@compiled
def _add_waves(waves: Array, x: float, y: float, z: float, t: float, point: Array) -> None:
    """Add linear waves, each of elevation a cos(kx x + ky y - omega t + phase), at a point in N. Airy theory, e.g. Holthuijsen 2007, section 5.4.

    The loops run over all waves, so that the processor can use its wide instructions. Sums are made in order, so that they do not depend on those.
    """
    work = np.empty((9, len(waves)))
    angle, sin, cos, along, across, head = work[0], work[1], work[2], work[3], work[4], work[5]
    for i in range(len(waves)):
        wave = waves[i]
        kx, ky, omega = wave[WAVE_KX], wave[WAVE_KY], wave[WAVE_OMEGA]
        angle[i] = kx * x + ky * y - omega * t + wave[WAVE_PHASE]
    _sines_and_cosines(angle, sin, cos)
    _fall_off(waves, z, along, across, head, work[6:])
    elevation = slope_x = slope_y = rise = heads = u = v = w = u_t = v_t = w_t = 0.0
    xx = xy = yy = zx = zy = xx_held = yy_held = zx_held = zy_held = 0.0
    for i in range(len(waves)):
        wave = waves[i]
        kx, ky, k, omega, a = wave[WAVE_KX], wave[WAVE_KY], wave[WAVE_K], wave[WAVE_OMEGA], wave[WAVE_AMPLITUDE]
        c, s = a * cos[i], a * sin[i]
        elevation, heads = elevation + c, heads + head[i] * c
        slope_x, slope_y, rise = slope_x + kx * s, slope_y + ky * s, rise + omega * s
        flat, upright = omega * along[i] / k, omega * across[i]
        u, v, w = u + kx * (flat * c), v + ky * (flat * c), w + upright * s
        sx, sy, c_v = kx * (flat * s), ky * (flat * s), upright * c
        u_t, v_t, w_t = u_t + omega * sx, v_t + omega * sy, w_t + omega * c_v
        xx, xy, yy = xx + kx * sx, xy + ky * sx, yy + ky * sy
        zx, zy = zx + kx * c_v, zy + ky * c_v
        if not 0.0 < z < wave[WAVE_DEPTH]:  # beyond them the value at the level or at the bottom holds
            xx_held, yy_held = xx_held + kx * sx, yy_held + ky * sy
            zx_held, zy_held = zx_held + kx * c_v, zy_held + ky * c_v
    point[ELEVATION], point[HEAD] = elevation, heads
    point[SLOPE], point[SLOPE + 1], point[ELEVATION_T] = -slope_x, -slope_y, rise
    point[V], point[V + 1], point[V + 2] = point[V] + u, point[V + 1] + v, point[V + 2] - w
    point[V_T], point[V_T + 1], point[V_T + 2] = point[V_T] + u_t, point[V_T + 1] + v_t, point[V_T + 2] + w_t
    # This flow is irrotational and incompressible: the gradient is symmetric, and its trace is zero.
    G = GRADIENT
    point[G], point[G + 1], point[G + 2] = point[G] - xx, point[G + 1] - xy, point[G + 2] - (zx - zx_held)
    point[G + 3], point[G + 4], point[G + 5] = point[G + 3] - xy, point[G + 4] - yy, point[G + 5] - (zy - zy_held)
    point[G + 6], point[G + 7] = point[G + 6] - zx, point[G + 7] - zy
    point[G + 8] += (xx - xx_held) + (yy - yy_held)


@compiled
def water_at(sea: Any, x: float, y: float, z: float, t: float, point: Array) -> None:
    """Find the water at a point of N (m) and a time t (s).

    Args:
        sea: `SeaRows`.
        point: (POINT_SIZE) out.
    """
    uniform = sea.uniform
    for i in range(POINT_SIZE):
        point[i] = 0.0
    for i in range(3):
        point[V + i] = uniform[i] + uniform[3 + i] * (t - uniform[6])
        point[V_T + i] = uniform[3 + i]
    _add_profiles(sea.profiles, z, point)
    if len(sea.waves) > 0:
        _add_waves(sea.waves, x, y, z, t, point)


@entry
def fill_flows(table: Array, sea: Any, t: float, ahead: float) -> None:
    """Find the water at the centre of buoyancy and the strips of each body, `ahead` seconds after t on the path of its present velocity.

    With the values at the middle of a tick, water that is linear in place and time within the tick is right to second order.

    Args:
        table: table of the world's rows (`handles`); its flows (n, FLOW_SIZE) and the water in strips are filled.
        sea: `SeaRows`.
        t, ahead: s.
    """
    share(team_at(table), _fill_range, (table, sea, t, ahead), state_at(table).shape[0], LEAST_FLOWS)


@compiled
def _fill_range(first: int, end: int, me: int, table: Array, sea: Any, t: float, ahead: float) -> None:
    bodies, state, flows, strips = bodies_at(table), state_at(table), flows_at(table), strips_at(table)
    R, point, p = np.empty((3, 3)), np.empty(POINT_SIZE), np.empty(3)
    kind = WAVY if sea.waves.shape[0] > 0 else MOVING
    for n in range(first, end):
        x, r, flow = state[n], bodies[n].r_b, flows[n]
        rotation(x[3], x[4], x[5], x[6], R)
        _place_ahead(x, R, r, ahead, p)
        water_at(sea, p[0], p[1], p[2], t + ahead, point)
        for i in range(FLOW_PLANE - FLOW_V):
            flow[FLOW_V + i] = point[V + i]  # velocity, rate and gradient have the same order in both
        sx, sy = point[SLOPE], point[SLOPE + 1]
        flow[FLOW_PLANE] = point[ELEVATION] - sx * p[0] - sy * p[1]
        flow[FLOW_PLANE + 1], flow[FLOW_PLANE + 2], flow[FLOW_PLANE + 3] = sx, sy, point[ELEVATION_T]
        for i in range(3):
            flow[FLOW_P + i] = p[i]
        flow[FLOW_T], flow[FLOW_KIND] = t + ahead, kind
        for k in range(bodies[n].strip_first, bodies[n].strip_first + bodies[n].strip_count):
            strip = strips[k]
            _place_ahead(x, R, strip.r, ahead, p)
            water_at(sea, p[0], p[1], p[2], t + ahead, point)
            for i in range(3):
                strip.p[i], strip.v[i], strip.v_t[i] = p[i], point[V + i], point[V_T + i]
                for j in range(3):
                    strip.gradient[i, j] = point[GRADIENT + 3 * i + j]


@compiled
def _place_ahead(x: Array, R: Array, r: Array, ahead: float, p: Array) -> None:
    """Write to p (N) where the point r (B) of a body in the state x will be after `ahead` seconds with its present velocity."""
    vx, vy, vz = velocity_at(x[NU:], r[0], r[1], r[2])
    for i in range(3):
        mount = R[i, 0] * r[0] + R[i, 1] * r[1] + R[i, 2] * r[2]
        p[i] = x[i] + mount + ahead * (R[i, 0] * vx + R[i, 1] * vy + R[i, 2] * vz)
