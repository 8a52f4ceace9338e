"""The border between our axes and those of ROS: N (NED) to ENU, B and S (FRD) to FLU, by REP-103 and REP-105.

All maps are their own inverse. Quaternions are w x y z here; ROS writes x y z w.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uwserver.frames import Quat, Vec3, multiply

_HALF = math.sqrt(0.5)

BEAM: Quat = (_HALF, 0.0, -_HALF, 0.0)
"""Attitude of the frame of an echosounder (it looks along x) in S, where it looks along z."""
SONAR: Quat = (_HALF, 0.0, _HALF, 0.0)
"""Attitude of the frame of a sonar's image (z ahead, x up) in S."""
_FLIP: Quat = (0.0, 1.0, 0.0, 0.0)


def flu(v: Sequence[float]) -> Vec3:
    """A vector of B or S in FLU axes."""
    return (v[0], -v[1], -v[2])


def enu(v: Sequence[float]) -> Vec3:
    """A vector of N in ENU axes."""
    return (v[1], v[0], -v[2])


def attitude(q: Sequence[float]) -> Quat:
    """Attitude of the FLU axes in ENU from that of the FRD axes in N."""
    w, x, y, z = q
    return (_HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z))


def covariance(rows: Sequence[float]) -> tuple[float, ...]:
    """A 3x3 covariance of S or B, row-major, in FLU axes: the signs of xy and xz turn."""
    a = rows
    return (a[0], -a[1], -a[2], -a[3], a[4], a[5], -a[6], a[7], a[8])


def mounted(q_BS: Sequence[float]) -> Quat:
    """Attitude of the FLU axes of a sensor in those of its body."""
    w, x, y, z = q_BS
    return (w, x, -y, -z)


def mounted_unflipped(q_BS: Sequence[float], q_SX: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> Quat:
    """Attitude of axes that a sensor's are not flipped to, in the FLU axes of its body.

    Args:
        q_BS: attitude of the sensor in B.
        q_SX: of these axes in S; default: S itself (x forward, y starboard, z down).
    """
    return multiply(multiply(_FLIP, q_BS), q_SX)
