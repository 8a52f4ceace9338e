"""Conversion between our axes and those of ROS (REP-103, REP-105): N (NED) and ENU, B and S (FRD) and FLU.

Each conversion of vectors and attitudes is its own inverse. Quaternions are w x y z here; ROS writes x y z w.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uwserver.frames import Quat, Vec3, multiply

_HALF = math.sqrt(0.5)

BEAM: Quat = (_HALF, 0.0, -_HALF, 0.0)
"""Attitude in S of an echosounder's frame. The device looks along x of that frame, and along z of S."""
SONAR: Quat = (_HALF, 0.0, _HALF, 0.0)
"""Attitude in S of the frame of a sonar image (z ahead, x up)."""
_FLIP: Quat = (0.0, 1.0, 0.0, 0.0)


def flu(v: Sequence[float]) -> Vec3:
    """Convert a vector of B or S (FRD axes) to FLU axes, or back."""
    return (v[0], -v[1], -v[2])


def enu(v: Sequence[float]) -> Vec3:
    """Convert a vector of N (NED axes) to ENU axes, or back."""
    return (v[1], v[0], -v[2])


def attitude(q: Sequence[float]) -> Quat:
    """Convert the attitude of FRD axes in N to that of FLU axes in ENU, or back."""
    w, x, y, z = q
    return (_HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z))


def covariance(rows: Sequence[float]) -> tuple[float, ...]:
    """Convert a 3x3 covariance of S or B, row-major, to FLU axes: the signs of xy and xz change."""
    a = rows
    return (a[0], -a[1], -a[2], -a[3], a[4], a[5], -a[6], a[7], a[8])


def mounted(q_BS: Sequence[float]) -> Quat:
    """Return the attitude of a sensor's FLU axes in the FLU axes of its body."""
    w, x, y, z = q_BS
    return (w, x, -y, -z)


def mounted_unflipped(q_BS: Sequence[float], q_SX: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> Quat:
    """Return the attitude of axes X, which are not flipped to FLU, in the FLU axes of a sensor's body.

    Args:
        q_BS: attitude of the sensor in B.
        q_SX: attitude of X in S; default: S itself (x forward, y starboard, z down).
    """
    return multiply(multiply(_FLIP, q_BS), q_SX)
