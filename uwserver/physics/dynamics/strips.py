"""A long hull in waves: what the water along it does to the body as a whole, and how it moves at a mount (compiled).

The hull is cut into strips, the points of a Gauss-Legendre rule (`strip_params`). What acts in M_A and damping is the rigid motion that fits
the velocity of the water along the hull best: its mean, and its first moment over that of the length, a turning across the hull. For a slender
hull of one section throughout that is strip theory: the moment of a_perp du/dt over the length is M_A times the rate of the turning. The
Froude-Krylov force is summed strip by strip, and so is its moment.
"""

from __future__ import annotations

from typing import Any

from uwserver.physics.dynamics.scratch import DU_DT, EXTRA, NU, PULL, STREAM, STREAM_RATE, WATER
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, inlined, separate
from uwserver.physics.kernel.layout import FLOW_T


@compiled
def _see(strip: Any, s: Array, source: int, lapse: float, R: Array, work: Array) -> None:
    """The water at one strip `lapse` s after that of its row was found: velocity in strip.u (N), its rate along the path of the strip in
    work[EXTRA, 3:], both in N; work[EXTRA, :3] is left with the acceleration of the water."""
    r, nu, G, extra = strip.r, work[NU], strip.gradient, work[EXTRA]
    vx = nu[0] + nu[4] * r[2] - nu[5] * r[1]
    vy = nu[1] + nu[5] * r[0] - nu[3] * r[2]
    vz = nu[2] + nu[3] * r[1] - nu[4] * r[0]
    dx = s[source, 0] - strip.p[0] + R[0, 0] * r[0] + R[0, 1] * r[1] + R[0, 2] * r[2]
    dy = s[source, 1] - strip.p[1] + R[1, 0] * r[0] + R[1, 1] * r[1] + R[1, 2] * r[2]
    dz = s[source, 2] - strip.p[2] + R[2, 0] * r[0] + R[2, 1] * r[1] + R[2, 2] * r[2]
    north = R[0, 0] * vx + R[0, 1] * vy + R[0, 2] * vz
    east = R[1, 0] * vx + R[1, 1] * vy + R[1, 2] * vz
    down = R[2, 0] * vx + R[2, 1] * vy + R[2, 2] * vz
    for i in range(3):
        strip.u[i] = strip.v[i] + lapse * strip.v_t[i] + G[i, 0] * dx + G[i, 1] * dy + G[i, 2] * dz
        extra[3 + i] = strip.v_t[i] + G[i, 0] * north + G[i, 1] * east + G[i, 2] * down
    for i in range(3):
        extra[i] = strip.v_t[i] + G[i, 0] * strip.u[0] + G[i, 1] * strip.u[1] + G[i, 2] * strip.u[2]


@separate
def along_hull(body: Any, strips: Array, s: Array, source: int, t: float, flow: Array, R: Array, work: Array) -> None:
    """The water along a hull at one instant; work[NU] is the body's velocity.

    Fills work[STREAM], the rigid motion of the water in B about the origin (m/s, rad/s), work[STREAM_RATE], its derivative in the turning
    frame B, work[WATER] and work[DU_DT], mean velocity and acceleration of the water in N, work[PULL, :3], the moment of the acceleration
    about r_b for each kg of displaced water (B, m2/s2), and the velocity at each strip. work[EXTRA] is overwritten.
    """
    nu, stream, rate = work[NU], work[STREAM], work[STREAM_RATE]
    for i in range(6):
        stream[i] = rate[i] = work[PULL, i] = work[WATER, i] = work[DU_DT, i] = 0.0
    b, extra, pull = body.r_b, work[EXTRA], work[PULL]
    for k in range(body.strip_first, body.strip_first + body.strip_count):
        strip = strips[k]
        _see(strip, s, source, t - flow[FLOW_T], R, work)
        share, u = strip.share, strip.u
        lx, ly, lz = share * (strip.r[0] - b[0]), share * (strip.r[1] - b[1]), share * (strip.r[2] - b[2])
        ux = R[0, 0] * u[0] + R[1, 0] * u[1] + R[2, 0] * u[2]
        uy = R[0, 1] * u[0] + R[1, 1] * u[1] + R[2, 1] * u[2]
        uz = R[0, 2] * u[0] + R[1, 2] * u[1] + R[2, 2] * u[2]
        # in the turning frame
        rx = R[0, 0] * extra[3] + R[1, 0] * extra[4] + R[2, 0] * extra[5] + nu[5] * uy - nu[4] * uz
        ry = R[0, 1] * extra[3] + R[1, 1] * extra[4] + R[2, 1] * extra[5] + nu[3] * uz - nu[5] * ux
        rz = R[0, 2] * extra[3] + R[1, 2] * extra[4] + R[2, 2] * extra[5] + nu[4] * ux - nu[3] * uy
        ax = R[0, 0] * extra[0] + R[1, 0] * extra[1] + R[2, 0] * extra[2]
        ay = R[0, 1] * extra[0] + R[1, 1] * extra[1] + R[2, 1] * extra[2]
        az = R[0, 2] * extra[0] + R[1, 2] * extra[1] + R[2, 2] * extra[2]
        for i in range(3):
            work[WATER, i] += share * u[i]
            work[DU_DT, i] += share * extra[i]
        stream[0] += share * ux
        stream[1] += share * uy
        stream[2] += share * uz
        stream[3] += ly * uz - lz * uy
        stream[4] += lz * ux - lx * uz
        stream[5] += lx * uy - ly * ux
        rate[0] += share * rx
        rate[1] += share * ry
        rate[2] += share * rz
        rate[3] += ly * rz - lz * ry
        rate[4] += lz * rx - lx * rz
        rate[5] += lx * ry - ly * rx
        pull[0] += ly * az - lz * ay
        pull[1] += lz * ax - lx * az
        pull[2] += lx * ay - ly * ax
    for i in range(3):
        stream[3 + i] *= body.strip_turn[i]
        rate[3 + i] *= body.strip_turn[i]
        pull[i] *= body.strip_moment[i]
    _to_origin(b, stream)
    _to_origin(b, rate)


@compiled
def _to_origin(b: Any, motion: Array) -> None:
    """The velocity at the origin of a rigid motion (6) whose velocity at b (B, m) is given."""
    motion[0] -= motion[4] * b[2] - motion[5] * b[1]
    motion[1] -= motion[5] * b[0] - motion[3] * b[2]
    motion[2] -= motion[3] * b[1] - motion[4] * b[0]


@inlined
def _gap(place: float, other: float) -> float:
    """From a strip to a place on the hull; not 0, which would make the interpolation 0 / 0."""
    gap = place - other
    return gap if abs(gap) > 1e-9 else 1e-9


@separate
def mount_velocity(
    body: Any, strips: Array, x: float, y: float, z: float, R: Array, work: Array
) -> tuple[float, float, float]:
    """Velocity (m/s, B) of a point (B, m) of the body through the water at that point.

    The water is interpolated along the hull after Hermite, from its velocity and gradient at each strip (`along_hull` was there), and goes on
    across the hull, and beyond its ends, by its gradient.
    """
    nu = work[NU]
    p, q, r = nu[3], nu[4], nu[5]
    vx, vy, vz = nu[0] + q * z - r * y, nu[1] + r * x - p * z, nu[2] + p * y - q * x
    b, extra = body.r_b, work[EXTRA]
    dx, dy, dz = x - b[0], y - b[1], z - b[2]
    along = dx if body.strip_axis == 0 else dy if body.strip_axis == 1 else dz
    place = min(max(along / body.strip_half, -1.0), 1.0)
    rest = place * body.strip_half
    if body.strip_axis == 0:
        dx -= rest
    elif body.strip_axis == 1:
        dy -= rest
    else:
        dz -= rest
    north = R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz
    east = R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz
    down = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
    total, a = 0.0, body.strip_axis
    for k in range(body.strip_first, body.strip_first + body.strip_count):
        total += strips[k].barycentric / _gap(place, strips[k].place)
    for i in range(3):
        extra[i] = 0.0
    for k in range(body.strip_first, body.strip_first + body.strip_count):
        strip = strips[k]
        G, gap = strip.gradient, _gap(place, strip.place)
        part = strip.barycentric / gap / total
        value, ahead = (1.0 - 2.0 * strip.bend * gap) * part * part, gap * part * part * body.strip_half
        gn, ge, gd = part * north + ahead * R[0, a], part * east + ahead * R[1, a], part * down + ahead * R[2, a]
        for i in range(3):
            extra[i] += value * strip.u[i] + G[i, 0] * gn + G[i, 1] * ge + G[i, 2] * gd
    ux, uy, uz = extra[0], extra[1], extra[2]
    return (
        vx - (R[0, 0] * ux + R[1, 0] * uy + R[2, 0] * uz),
        vy - (R[0, 1] * ux + R[1, 1] * uy + R[2, 1] * uz),
        vz - (R[0, 2] * ux + R[1, 2] * uy + R[2, 2] * uz),
    )
