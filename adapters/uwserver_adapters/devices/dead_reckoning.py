"""Position from velocities and attitudes, as a DVL with an inertial unit of its own reckons it."""

from __future__ import annotations

import math
from collections import deque

from uwserver.frames import rotate, rpy_from_quat
from uwserver_adapters.devices.codec import NANOSECONDS

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

REMEMBERED = 256
"""Attitudes that are kept: the velocity of a ping comes later than the attitude of its time."""
GAP_S = 1.0
"""Simulation time for which a velocity holds; then the position stands still until the next."""


class DeadReckoning:
    """Sums velocities. The frame has its origin where it began, its x axis in the horizontal direction in which x of the device pointed then,
    and z down.

    Attributes:
        t_ns: simulation time of the newest attitude; -1 before the first.
        variance: of each axis of the position, m^2: the errors of pings are taken as independent.
    """

    def __init__(self) -> None:
        self._attitudes: deque[tuple[int, Quaternion]] = deque(maxlen=REMEMBERED)
        self.reset()

    def reset(self) -> None:
        """The position is zero from now on, and so is the heading."""
        newest = self._attitudes[-1][1] if self._attitudes else None
        self._yaw0: float | None = None if newest is None else rpy_from_quat(newest)[2]
        self._p: Vector = (0.0, 0.0, 0.0)
        self._v: Vector = (0.0, 0.0, 0.0)
        self._v_ns = -1
        self.variance = 0.0

    def forget(self) -> None:
        """Time begins again."""
        self._attitudes.clear()
        self.reset()

    @property
    def t_ns(self) -> int:
        """See there."""
        return self._attitudes[-1][0] if self._attitudes else -1

    def see_attitude(self, t_ns: int, q: Quaternion) -> None:
        """The device's attitude in N, w x y z."""
        self._attitudes.append((t_ns, q))
        if self._yaw0 is None:
            self._yaw0 = rpy_from_quat(q)[2]

    def see_velocity(self, t_ns: int, v: Vector, sigma: float) -> None:
        """The device's velocity over ground along its own axes, m/s, and its standard deviation."""
        if not self._attitudes:
            return
        _, q = min(self._attitudes, key=lambda entry: abs(entry[0] - t_ns))
        before, self._v = self._v, rotate(q, v)
        dt = (t_ns - self._v_ns) / NANOSECONDS
        if self._v_ns >= 0 and 0.0 < dt <= GAP_S:
            mean = [0.5 * (a + b) for a, b in zip(before, self._v, strict=True)]
            self._p = (self._p[0] + mean[0] * dt, self._p[1] + mean[1] * dt, self._p[2] + mean[2] * dt)
            self.variance += (sigma * dt) ** 2
        self._v_ns = t_ns

    @property
    def is_tracking(self) -> bool:
        """Whether the last velocity still holds."""
        return self._v_ns >= 0 and abs(self.t_ns - self._v_ns) <= GAP_S * NANOSECONDS

    def position(self) -> Vector:
        """At the time of the newest attitude, m, in the frame where it began."""
        x, y, z = self._p
        if self.is_tracking:
            ahead = (self.t_ns - self._v_ns) / NANOSECONDS
            x, y, z = x + self._v[0] * ahead, y + self._v[1] * ahead, z + self._v[2] * ahead
        c, s = math.cos(self._yaw0 or 0.0), math.sin(self._yaw0 or 0.0)
        return c * x + s * y, c * y - s * x, z

    def attitude(self) -> Vector:
        """Roll, pitch and yaw, rad; yaw from where it began, within half a turn."""
        roll, pitch, yaw = rpy_from_quat(self._attitudes[-1][1])
        return roll, pitch, math.remainder(yaw - (self._yaw0 or 0.0), 2.0 * math.pi)
