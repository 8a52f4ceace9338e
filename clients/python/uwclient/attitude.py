"""Quaternions and angles in the conventions of the server.

A quaternion (w, x, y, z) turns vectors from the second frame of its name into the first: `q_NB` turns a vector from B (forward, right,
down) into N (north, east, down), so ``rotate(q_NB, (1, 0, 0))`` is where the bow points. Roll, pitch and yaw are about x, y and z of B, with
yaw applied first (z-y-x); yaw is the heading, clockwise from north. Angles are in rad. Only the standard library is needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the attitude with this roll, pitch and yaw."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def to_rpy(q: Sequence[float]) -> Vector:
    """Return roll (-pi..pi), pitch (-pi/2..pi/2) and yaw (-pi..pi). With the bow straight up or down, roll is 0 and yaw has the whole rotation."""
    w, x, y, z = q
    sine = 2.0 * (w * y - z * x)
    if abs(sine) > 1.0 - 1e-12:
        return 0.0, math.copysign(0.5 * math.pi, sine), wrapped(-2.0 * math.copysign(1.0, sine) * math.atan2(x, w))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, math.asin(sine), heading(q)


def heading(q: Sequence[float]) -> float:
    """Return where the bow points, clockwise from north, -pi..pi."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def product(p: Sequence[float], q: Sequence[float]) -> Quaternion:
    """Return the rotation q followed by p.

    ``q_AC = product(q_AB, q_BC)``
    """
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def inverse(q: Sequence[float]) -> Quaternion:
    """Return the inverse rotation of a unit quaternion.

    ``q_BN = inverse(q_NB)``
    """
    w, x, y, z = q
    return w, -x, -y, -z


def rotate(q: Sequence[float], v: Sequence[float]) -> Vector:
    """Return a vector of the second frame in the first frame.

    ``v_N = rotate(q_NB, v_B)``
    """
    _, x, y, z = product(product(q, (0.0, *v)), inverse(q))
    return x, y, z


def rotation_vector(q: Sequence[float]) -> Vector:
    """Return the axis of a rotation times its angle (0..pi).

    ``rotation_vector(product(inverse(q_NB), q_NB_wanted))`` is the error on which an attitude controller acts: how to turn, in B.
    """
    w, x, y, z = q if q[0] >= 0.0 else tuple(-each for each in q)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 1e-12 else 2.0
    return scale * x, scale * y, scale * z


def wrapped(angle: float) -> float:
    """Return the same direction within -pi..pi: ``wrapped(wanted - heading)`` is the short way round."""
    return math.remainder(angle, 2.0 * math.pi)
