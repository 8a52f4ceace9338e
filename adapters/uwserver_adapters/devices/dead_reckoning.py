"""Dead reckoning: position from velocities and attitudes, as in a DVL with an inertial unit of its own."""

from __future__ import annotations

import math
from collections import deque

from uwserver.frames import Quat, Vec3, rotate, rpy_from_quat
from uwserver_adapters.devices.codec import NANOSECONDS

REMEMBERED = 256
"""Attitudes that are kept: the velocity of a ping arrives later than the attitude of the same time."""
GAP_S = 1.0
"""Simulation time for which a velocity holds. After that the position stands still until the next one."""


class DeadReckoning:
    """Integrates velocities. The origin of the frame is the position at the start, z is down, and x is the horizontal direction in which x of the
    device pointed at the start.

    Attributes:
        variance: variance of each axis of the position, m^2. The errors of pings are taken as independent.
    """

    def __init__(self) -> None:
        self._attitudes: deque[tuple[int, Quat]] = deque(maxlen=REMEMBERED)
        self.reset()

    def reset(self) -> None:
        """Set position and heading to zero."""
        newest = self._attitudes[-1][1] if self._attitudes else None
        self._yaw0: float | None = None if newest is None else rpy_from_quat(newest)[2]
        self._p: Vec3 = (0.0, 0.0, 0.0)
        self._v: Vec3 = (0.0, 0.0, 0.0)
        self._v_ns = -1
        self.variance = 0.0

    def forget(self) -> None:
        """Start again at another time."""
        self._attitudes.clear()
        self.reset()

    @property
    def t_ns(self) -> int:
        """Simulation time of the newest attitude; -1 before the first."""
        return self._attitudes[-1][0] if self._attitudes else -1

    def see_attitude(self, t_ns: int, q: Quat) -> None:
        """Take the device's attitude in N, w x y z."""
        self._attitudes.append((t_ns, q))
        if self._yaw0 is None:
            self._yaw0 = rpy_from_quat(q)[2]

    def see_velocity(self, t_ns: int, v: Vec3, sigma: float) -> None:
        """Take the device's velocity over ground along its own axes, m/s, and its standard deviation."""
        if not self._attitudes:
            return
        _, q = min(self._attitudes, key=lambda entry: abs(entry[0] - t_ns))
        before, self._v = self._v, rotate(q, v)
        dt = (t_ns - self._v_ns) / NANOSECONDS
        if self._v_ns >= 0 and 0.0 < dt <= GAP_S:
            # The trapezoidal rule: the mean of the velocities at both ends.
            x, y, z = (p + 0.5 * (a + b) * dt for p, a, b in zip(self._p, before, self._v, strict=True))
            self._p = (x, y, z)
            self.variance += (sigma * dt) ** 2
        self._v_ns = t_ns

    @property
    def is_tracking(self) -> bool:
        """Whether the last velocity still holds."""
        return self._v_ns >= 0 and abs(self.t_ns - self._v_ns) <= GAP_S * NANOSECONDS

    def position(self) -> Vec3:
        """Return the position at the time of the newest attitude, m."""
        x, y, z = self._p
        if self.is_tracking:
            ahead = (self.t_ns - self._v_ns) / NANOSECONDS
            x, y, z = x + self._v[0] * ahead, y + self._v[1] * ahead, z + self._v[2] * ahead
        c, s = math.cos(self._yaw0 or 0.0), math.sin(self._yaw0 or 0.0)
        return c * x + s * y, c * y - s * x, z

    def attitude(self) -> Vec3:
        """Return roll, pitch and yaw, rad; yaw is relative to the start, within half a turn."""
        roll, pitch, yaw = rpy_from_quat(self._attitudes[-1][1])
        return roll, pitch, math.remainder(yaw - (self._yaw0 or 0.0), 2.0 * math.pi)
