"""PX4's simulator interface in MAVLink 2: decodes the autopilot's messages, and encodes samples as messages. Sans-IO; needs pymavlink."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from uwserver.frames import Quat, Vec3, rotate
from uwserver.units import deg

SYSTEM, COMPONENT = 142, 200
"""Our numbers as a MAVLink node. PX4 checks neither."""

CONTROLS = 16
"""Actuator outputs in a message."""
_ARMED, _LOCKSTEP = 128, 1
_IMU = 0b111111
_MAGNETOMETER = 0b111 << 6
_BAROMETER = 0b1101 << 9

EARTH_RADIUS_M = 6_378_137.0
MICROSECOND_NS = 1000
_UNKNOWN_COURSE = 65535

_P0_HPA, _T0_K, _LAPSE_KPM, _EXPONENT = 1013.25, 288.15, 0.0065, 5.2559
"""Standard atmosphere below 11 km: pressure and temperature at its zero, temperature lapse, and exponent of the pressure."""


class Greeting(NamedTuple):
    """The autopilot has spoken."""


class Interval(NamedTuple):
    """The autopilot requests a message every `seconds`. A negative number stops it, and 0 leaves the rate to us."""

    message: int
    seconds: float


class Controls(NamedTuple):
    """Actuator outputs.

    Attributes:
        t_us: the autopilot's time. In lock-step this is the time of the newest sensor message on which they are based.
        levels: -1 to 1 by channel; zeros while disarmed.
        is_armed: whether the autopilot is armed.
        is_lockstep: whether the autopilot's time stands still until the next sensor message.
        limited: number of outputs that were out of range or no number.
    """

    t_us: int
    levels: tuple[float, ...]
    is_armed: bool
    is_lockstep: bool
    limited: int


Event = Greeting | Interval | Controls


class Codec:
    """The codec of one connection.

    Attributes:
        bad: number of bytes and messages that were not understood.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._mav = mavlink.MAVLink(None, SYSTEM, COMPONENT)
        self._mav.robust_parsing = True

    # -- in -------------------------------------------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> list[Event]:
        """Return what these bytes complete."""
        events: list[Event] = []
        for message in self._mav.parse_buffer(data) or ():
            event = self._event(message)
            if event is not None:
                events.append(event)
        return events

    def _event(self, message: Any) -> Event | None:
        kind = message.get_type()
        if kind == "HIL_ACTUATOR_CONTROLS":
            return _controls(message)
        if kind == "HEARTBEAT":
            # A ground station that looks for a vehicle here also sends a heartbeat, which must not count as an autopilot's.
            return None if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID else Greeting()
        if kind == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            if math.isfinite(message.param1) and math.isfinite(message.param2):
                return Interval(int(message.param1), message.param2 * 1e-6)
            self.bad += 1
        elif kind == "BAD_DATA":
            self.bad += 1
        return None

    # -- out ------------------------------------------------------------------------------------------------------------------------

    def _pack(self, message: Any) -> bytes:
        data = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return bytes(data)

    def heartbeat(self) -> bytes:
        """Return our heartbeat."""
        return self._pack(
            self._mav.heartbeat_encode(
                mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
        )

    def sensor(
        self, t_ns: int, f_B: Vec3, w_B: Vec3, field_B: Vec3 | None, depth: float | None, temperature: float
    ) -> bytes:
        """Return HIL_SENSOR: specific force (m/s2), angular rate (rad/s), and magnetic field (T) and depth (m) if they are new.

        PX4 does not know the pressure of water, so the depth is sent as the pressure of air at the altitude -depth.
        """
        updated = _IMU
        gauss = (0.0, 0.0, 0.0)
        if field_B is not None:
            updated |= _MAGNETOMETER
            gauss = (field_B[0] * 1e4, field_B[1] * 1e4, field_B[2] * 1e4)
        pressure = altitude = 0.0
        if depth is not None:
            updated |= _BAROMETER
            altitude = -depth
            pressure = air_pressure_hPa(altitude)
        return self._pack(
            self._mav.hil_sensor_encode(
                t_ns // MICROSECOND_NS, *f_B, *w_B, *gauss, pressure, 0.0, altitude, temperature, updated, 0
            )
        )

    def gps(
        self, t_ns: int, latitude: float, longitude: float, height: float, v_NS: Vec3, accuracies: tuple[float, float],
        satellites: int, fix: int,
    ) -> bytes:  # fmt: skip
        """Return HIL_GPS: angles in rad, height in m, velocity in N in m/s, and horizontal and vertical accuracy in m."""
        speed = math.hypot(v_NS[0], v_NS[1])
        course = round(deg(math.atan2(v_NS[1], v_NS[0]) % math.tau) * 100.0) % 36000 if speed > 0.0 else _UNKNOWN_COURSE
        eph, epv = (min(round(accuracy * 100.0), 65535) for accuracy in accuracies)
        north, east, down = (_int16(v * 100.0) for v in v_NS)
        return self._pack(
            self._mav.hil_gps_encode(
                t_ns // MICROSECOND_NS, fix, round(deg(latitude) * 1e7), round(deg(longitude) * 1e7),
                round(height * 1000.0), eph, epv, min(round(speed * 100.0), 65535), north, east, down, course,
                min(max(satellites, 0), 255),
            )
        )  # fmt: skip

    def state(
        self, t_ns: int, origin: tuple[float, float], p_NB: Vec3, q_NB: Quat, v_NB_B: Vec3, w_NB_B: Vec3, f_B: Vec3
    ) -> bytes:
        """Return HIL_STATE_QUATERNION, the truth for the autopilot's log. `origin`: latitude and longitude of N's origin, rad."""
        latitude = origin[0] + p_NB[0] / EARTH_RADIUS_M
        longitude = origin[1] + p_NB[1] / (EARTH_RADIUS_M * math.cos(origin[0]))
        velocity = (_int16(v * 100.0) for v in rotate(q_NB, v_NB_B))
        force = (_int16(f / 9.80665 * 1000.0) for f in f_B)
        return self._pack(
            self._mav.hil_state_quaternion_encode(
                t_ns // MICROSECOND_NS, q_NB, *w_NB_B, round(deg(latitude) * 1e7), round(deg(longitude) * 1e7),
                round(-p_NB[2] * 1000.0), *velocity, 0, 0, *force,
            )
        )  # fmt: skip

    def odometry(
        self, t_ns: int, p_NB: Vec3, q_NB: Quat, v_NB_B: Vec3, w_NB_B: Vec3, sigma: tuple[float, float, float]
    ) -> bytes:
        """Return ODOMETRY: position in N, velocity in B. `sigma`: standard deviations of position (m), attitude (rad) and velocity (m/s)."""
        position, attitude, velocity = (value * value for value in sigma)
        return self._pack(
            self._mav.odometry_encode(
                t_ns // MICROSECOND_NS, mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD, *p_NB, q_NB, *v_NB_B,
                *w_NB_B, _triangle(position, attitude), _triangle(velocity, attitude), 0,
                mavlink.MAV_ESTIMATOR_TYPE_VISION, 100,
            )
        )  # fmt: skip

    def distance(self, t_ns: int, number: int, distance: float, limits: tuple[float, float]) -> bytes:
        """Return DISTANCE_SENSOR of a sensor that looks down: its distance and its limits, m."""
        low, high = (min(round(limit * 100.0), 65535) for limit in limits)
        return self._pack(
            self._mav.distance_sensor_encode(
                t_ns // 1_000_000 % 2**32, low, high, min(max(round(distance * 100.0), 0), 65535),
                mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND, number, mavlink.MAV_SENSOR_ROTATION_PITCH_270, 255,
            )
        )  # fmt: skip


def _controls(message: Any) -> Controls:
    armed = bool(message.mode & _ARMED)
    given: Sequence[float] = message.controls
    levels = tuple(min(max(level, -1.0), 1.0) if math.isfinite(level) else 0.0 for level in given)
    limited = sum(level != value for level, value in zip(levels, given, strict=True))
    is_lockstep = bool(message.flags & _LOCKSTEP)
    return Controls(message.time_usec, levels if armed else (0.0,) * CONTROLS, armed, is_lockstep, limited)


def _int16(value: float) -> int:
    return min(max(round(value), -32768), 32767)


def _triangle(linear: float, angular: float) -> list[float]:
    """Return the upper right triangle of a diagonal 6 x 6 covariance matrix."""
    diagonal = [linear] * 3 + [angular] * 3
    return [diagonal[row] if row == column else 0.0 for row in range(6) for column in range(row, 6)]


def air_pressure_hPa(altitude: float) -> float:
    """Return the pressure of the standard atmosphere at an altitude (m), also below zero: what a barometer would show that knows only air."""
    return _P0_HPA * math.pow(max(1.0 - _LAPSE_KPM * altitude / _T0_K, 0.0), _EXPONENT)
