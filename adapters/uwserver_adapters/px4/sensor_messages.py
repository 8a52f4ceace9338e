"""The sensor messages that are due after a step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from uwserver.adapter import Reading, Readings
from uwserver.frames import Vec3
from uwserver_adapters.sil.codec import nanoseconds, radians
from uwserver_adapters.sil.in_the_loop import inertial

if TYPE_CHECKING:
    from uwserver_adapters.px4.codec import Codec, Interval

HIL_STATE_QUATERNION = 115
STATE_S = 0.005
"""Interval that PX4 requests, and that is used until it does, s."""


class Roles(NamedTuple):
    """The reading for each role; None for what is not sent."""

    imu: Reading
    pose: Reading
    velocity: Reading
    magnetometer: Reading | None
    depth: Reading | None
    gps: Reading | None
    distances: tuple[tuple[Reading, tuple[float, float]], ...]


class SensorMessages:
    """The newest samples, and which of them the autopilot has already got.

    Args:
        readings: all readings of `roles`.
        roles: the reading for each role.
        origin_deg: latitude and longitude of N's origin.
        odometry_s: simulation time between two ODOMETRY messages; 0 for none.
        sigma: their standard deviations: position (m), attitude (rad), velocity (m/s).

    Attributes:
        readings: as given.
        told_ns: time of the newest messages, by the autopilot's clock.
    """

    def __init__(
        self, readings: Readings, roles: Roles, origin_deg: tuple[float, float], odometry_s: float,
        sigma: tuple[float, float, float],
    ) -> None:  # fmt: skip
        self.readings = readings
        self.told_ns = 0
        self._roles = roles
        self._origin = (radians(origin_deg[0]), radians(origin_deg[1]))
        self._odometry_s = odometry_s
        self._sigma = sigma
        self._state_s = STATE_S
        self._told: dict[str, int] = {}
        self._next: dict[str, int] = {}
        self._shift_ns = 0

    def restart(self) -> None:
        """Send everything again, because another autopilot has connected."""
        self._told.clear()
        self._state_s = STATE_S

    def ask(self, interval: Interval) -> None:
        """Set how often a message is sent."""
        if interval.message == HIL_STATE_QUATERNION:
            self._state_s = interval.seconds or STATE_S

    def messages(self, codec: Codec, t_ns: int) -> bytes:
        """Return all messages that are due at simulation time t_ns; b"" before the first samples of pose and velocity."""
        roles = self._roles
        pose: Any = roles.pose.values
        velocity: Any = roles.velocity.values
        if pose is None or velocity is None:
            return b""
        now = self._monotonic(t_ns)
        p_NB, q_NB = pose
        v_NB_B, w_NB_B = velocity
        w_B, f_B = inertial(roles.imu.values, q_NB, w_NB_B)
        truth = odometry = b""
        if self._is_due("state", now, self._state_s):
            truth = codec.state(now, self._origin, p_NB, q_NB, v_NB_B, w_NB_B, f_B)
        if self._is_due("odometry", now, self._odometry_s):
            odometry = codec.odometry(now, p_NB, q_NB, v_NB_B, w_NB_B, self._sigma)
        parts = [self._sensor(codec, now, f_B, w_B), self._gps(codec, now), truth, odometry]
        return b"".join([*parts, *self._distances(codec, now)])

    def _monotonic(self, t_ns: int) -> int:
        """Return the time for the autopilot, whose clock cannot go back. After a reset of the world it continues from where it was."""
        now = t_ns + self._shift_ns
        if now <= self.told_ns:
            self._shift_ns += self.told_ns - now + nanoseconds(1e-3)
            now = t_ns + self._shift_ns
        self.told_ns = now
        return now

    def _is_due(self, what: str, now: int, interval_s: float) -> bool:
        due = self._next.get(what, 0)
        if interval_s <= 0.0 or now < due:
            return False
        step = nanoseconds(interval_s)
        self._next[what] = due + step if now < due + step else now + step
        return True

    def _fresh(self, reading: Reading | None) -> Any:
        if reading is None or reading.values is None or self._told.get(reading.path) == reading.count:
            return None
        self._told[reading.path] = reading.count
        return reading.values

    def _sensor(self, codec: Codec, now: int, f_B: Vec3, w_B: Vec3) -> bytes:
        field = self._fresh(self._roles.magnetometer)
        depth = self._fresh(self._roles.depth)
        return codec.sensor(
            now, f_B, w_B, field and field[0], depth and depth[0], float(depth[1]) if depth else 0.0
        )  # fmt: skip

    def _gps(self, codec: Codec, now: int) -> bytes:
        fix = self._fresh(self._roles.gps)
        if fix is None:
            return b""
        latitude, longitude, height, velocity, horizontal, vertical, satellites, kind = fix
        return codec.gps(now, latitude, longitude, height, velocity, (horizontal, vertical), satellites, kind)

    def _distances(self, codec: Codec, now: int) -> list[bytes]:
        found = []
        for number, (reading, limits) in enumerate(self._roles.distances):
            values = self._fresh(reading)
            if values is not None:
                found.append(codec.distance(now, number, float(values[0]), limits))
        return found
