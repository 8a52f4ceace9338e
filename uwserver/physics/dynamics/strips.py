"""A long hull in waves: the effect of the water along it on the body as a whole, and the velocity through the water at a mount (compiled).

The hull is cut into strips, the points of a Gauss-Legendre rule (`strip_params`). M_A and damping act on the rigid motion that fits the velocity of
the water along the hull best: its mean, and its first moment over that of the length, which is a turning. For a slender uniform hull this is strip
theory: the moment of a_perp du/dt over the length is M_A times the rate of the turning. The Froude-Krylov force is summed strip by strip, and so is
its moment.
"""

from __future__ import annotations

from typing import Any

from uwserver.physics.dynamics.scratch import DU_DT, EXTRA, NU, PULL, STREAM, STREAM_RATE, WATER
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, inlined, separate
from uwserver.physics.kernel.layout import FLOW_T
from uwserver.physics.kernel.linear import to_body, to_world, velocity_at


@compiled
def extrapolate(
    s: Array, source: int, nu: Array, R: Array, r: Array, place: Array, v: Array, v_t: Array, G: Array, lapse: float,
    velocity: Array, rate: Array, acceleration: Array,
) -> None:  # fmt: skip
    """Find the water at a point of a body from that at a place near it, in N.

    Args:
        s, source: states, and the row of that of the body.
        nu: (6) velocity of the body.
        R: (3, 3) R_NB.
        r: (3) the point, B, m.
        place: (3) where the water is known, N, m.
        v, v_t, G: (3), (3), (3, 3) its velocity, the partial derivative of that by time, and its gradient there.
        lapse: how long ago that was, s.
        velocity: (3) out, m/s.
        rate: (3) out, derivative of the velocity along the path of the point, m/s2.
        acceleration: (3) out, of the water itself (Du/Dt), m/s2.
    """
    vx, vy, vz = velocity_at(nu, r[0], r[1], r[2])
    north, east, down = to_world(R, vx, vy, vz)
    dx = s[source, 0] - place[0] + R[0, 0] * r[0] + R[0, 1] * r[1] + R[0, 2] * r[2]
    dy = s[source, 1] - place[1] + R[1, 0] * r[0] + R[1, 1] * r[1] + R[1, 2] * r[2]
    dz = s[source, 2] - place[2] + R[2, 0] * r[0] + R[2, 1] * r[1] + R[2, 2] * r[2]
    for i in range(3):
        velocity[i] = v[i] + lapse * v_t[i] + G[i, 0] * dx + G[i, 1] * dy + G[i, 2] * dz
        rate[i] = v_t[i] + G[i, 0] * north + G[i, 1] * east + G[i, 2] * down
    for i in range(3):
        acceleration[i] = v_t[i] + G[i, 0] * velocity[0] + G[i, 1] * velocity[1] + G[i, 2] * velocity[2]


@inlined
def _add_first_moment(motion: Array, share: float, x: float, y: float, z: float, u: float, v: float, w: float) -> None:
    """Add to a rigid motion (6) a velocity (u, v, w), weighted by `share`, and its moment about (x, y, z), which is weighted already."""
    motion[0] += share * u
    motion[1] += share * v
    motion[2] += share * w
    motion[3] += y * w - z * v
    motion[4] += z * u - x * w
    motion[5] += x * v - y * u


@separate
def along_hull(body: Any, strips: Array, s: Array, source: int, t: float, flow: Array, R: Array, work: Array) -> None:
    """Find the water along a hull at one instant; work[NU] is the velocity of the body.

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
        extrapolate(
            s, source, nu, R, strip.r, strip.p, strip.v, strip.v_t, strip.gradient, t - flow[FLOW_T], strip.u, extra[3:], extra[:3]
        )  # fmt: skip
        share, u = strip.share, strip.u
        lx, ly, lz = share * (strip.r[0] - b[0]), share * (strip.r[1] - b[1]), share * (strip.r[2] - b[2])
        ux, uy, uz = to_body(R, u[0], u[1], u[2])
        # in the turning frame
        rx = R[0, 0] * extra[3] + R[1, 0] * extra[4] + R[2, 0] * extra[5] + nu[5] * uy - nu[4] * uz
        ry = R[0, 1] * extra[3] + R[1, 1] * extra[4] + R[2, 1] * extra[5] + nu[3] * uz - nu[5] * ux
        rz = R[0, 2] * extra[3] + R[1, 2] * extra[4] + R[2, 2] * extra[5] + nu[4] * ux - nu[3] * uy
        ax, ay, az = to_body(R, extra[0], extra[1], extra[2])
        for i in range(3):
            work[WATER, i] += share * u[i]
            work[DU_DT, i] += share * extra[i]
        _add_first_moment(stream, share, lx, ly, lz, ux, uy, uz)
        _add_first_moment(rate, share, lx, ly, lz, rx, ry, rz)
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
    """Move a rigid motion (6), whose velocity is given at b (B, m), to the origin."""
    motion[0] -= motion[4] * b[2] - motion[5] * b[1]
    motion[1] -= motion[5] * b[0] - motion[3] * b[2]
    motion[2] -= motion[3] * b[1] - motion[4] * b[0]


@inlined
def _gap(place: float, other: float) -> float:
    """Return the distance from a strip to a place on the hull; never 0, where the interpolation would be 0 / 0."""
    gap = place - other
    return gap if abs(gap) > 1e-9 else 1e-9


@separate
def mount_velocity(
    body: Any, strips: Array, x: float, y: float, z: float, R: Array, work: Array
) -> tuple[float, float, float]:
    """Return the velocity (m/s, B) of a point (B, m) of the body through the water at that point.

    The water is interpolated along the hull after Hermite, from its velocity and gradient at each strip, which `along_hull` has found. Across the
    hull, and beyond its ends, it is extrapolated with its gradient.
    """
    nu = work[NU]
    vx, vy, vz = velocity_at(nu, x, y, z)
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
    north, east, down = to_world(R, dx, dy, dz)
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
    ux, uy, uz = to_body(R, extra[0], extra[1], extra[2])
    return vx - ux, vy - uy, vz - uz
