"""Rotations between the frames N (NED), B (FRD body), S (sensor), ENU and FLU. All rotations of uwserver are here.

Quaternions are ``(w, x, y, z)`` and rotate from the second frame of their name to the first: ``v_N = rotate(q_NB, v_B)``. All functions are pure and
work on plain floats, which at these sizes is ten to a hundred times faster than numpy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)

_VERTICAL = 1.0 - 1e-12
"""Sine of pitch above which roll and yaw cannot be separated: 1.4e-6 rad from the vertical."""


def quat_from_rpy(roll: float, pitch: float, yaw: float) -> Quat:
    """Return the unit quaternion q_NB of the zyx Euler angles (rad): yaw about z, then pitch about y, then roll about x."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def rpy_from_quat(q: Sequence[float]) -> Vec3:
    """Return roll, pitch, yaw (rad) of a unit quaternion. At a pitch of +-pi/2 the whole rotation about the vertical is yaw, and roll is zero."""
    w, x, y, z = q
    sine = 2 * (w * y - z * x)
    if abs(sine) > _VERTICAL:  # roll and yaw would consist of rounding errors
        return 0.0, math.copysign(math.pi / 2, sine), math.atan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(sine)
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def multiply(a: Sequence[float], b: Sequence[float]) -> Quat:
    """Return the Hamilton product: ``q_NS = multiply(q_NB, q_BS)``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: Sequence[float]) -> Quat:
    """Return the inverse rotation of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def rotate(q: Sequence[float], v: Sequence[float]) -> Vec3:
    """Return a vector rotated by a unit quaternion: with ``q_NB`` components in B become components in N."""
    w, x, y, z = q
    vx, vy, vz = v
    tx = 2 * (y * vz - z * vy)
    ty = 2 * (z * vx - x * vz)
    tz = 2 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def matrix(q: Sequence[float]) -> tuple[Vec3, Vec3, Vec3]:
    """Return the rows of the matrix that rotates vectors as `rotate` does: R_NB for a unit quaternion ``q_NB``."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def spin(w: Sequence[float], t: float) -> Quat:
    """Return the rotation of a body that turns at w (rad/s) for a time t (s, may be negative). If w is in the frame of the body, multiply its
    attitude by it from the right."""
    rate = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    half = 0.5 * rate * t
    along = math.sin(half) / rate if rate > 0.0 else 0.0
    return (math.cos(half), along * w[0], along * w[1], along * w[2])


def ned_from_enu(v: Sequence[float]) -> Vec3:
    """Return the NED components of a vector from its ENU components, or the reverse: the swap is its own inverse."""
    return (v[1], v[0], -v[2])


def frd_from_flu(v: Sequence[float]) -> Vec3:
    """Return the FRD components of a vector from its FLU components, or the reverse: the swap is its own inverse."""
    return (v[0], -v[1], -v[2])


_HALF = math.sqrt(0.5)
_Q_ENU_NED: Quat = (0.0, _HALF, _HALF, 0.0)
_Q_FRD_FLU: Quat = (0.0, 1.0, 0.0, 0.0)


def attitude_enu_flu(q_NB: Sequence[float]) -> Quat:
    """Return the attitude of the FLU body in ENU from that of the FRD body in NED (ROS REP 103)."""
    return multiply(multiply(_Q_ENU_NED, q_NB), _Q_FRD_FLU)
