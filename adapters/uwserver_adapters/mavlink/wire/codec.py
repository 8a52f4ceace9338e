"""Units of MAVLink to and from SI and N: scaled integers, degrees, pulses and the ellipsoid. `dialect.py` keeps values within their range."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from uwserver.adapter.earth import latitude_longitude, north_east
from uwserver.frames import Vec3
from uwserver.units import NANOSECONDS, STANDARD_ATMOSPHERE_PA, deg, rad

_TURN = 2 * math.pi
_DEG_E7 = 1e7
_LARGEST = 1e30
"""No real quantity is as large as this, and a thousand times as much still fits into a float of 32 bits."""
NEUTRAL_US, SPAN_US = 1500, 400
"""Pulse width at rest, and its change at full deflection, us."""
STANDARD_GRAVITY = 9.80665
"""One g, m/s^2."""
STANDARD_ATMOSPHERE = STANDARD_ATMOSPHERE_PA
"""Pressure at the sea surface, Pa."""
from_degrees, degrees = rad, deg
"""Degrees to radians, and back."""


def finite(value: object) -> float | None:
    """Return a finite number of a size that occurs (below 1e30), or None for anything else."""
    return float(value) if isinstance(value, int | float) and abs(value) < _LARGEST else None


def vector(value: object, size: int) -> tuple[float, ...] | None:
    """Return a sequence of `size` finite numbers, or None for anything else."""
    if not isinstance(value, tuple | list) or len(value) != size:
        return None
    numbers = [finite(entry) for entry in value]
    return None if None in numbers else tuple(number for number in numbers if number is not None)


def vec3(value: object) -> Vec3 | None:
    """Return three finite numbers, or None for anything else."""
    row = vector(value, 3)
    return None if row is None else (row[0], row[1], row[2])


def degrees_e7(angle: float) -> float:
    """Convert radians to 1e-7 degrees."""
    return deg(angle) * _DEG_E7


def from_degrees_e7(scaled: float) -> float:
    """Convert 1e-7 degrees to radians."""
    return rad(scaled / _DEG_E7)


def compass_centidegrees(yaw: float) -> int:
    """Convert a yaw angle (rad) to a heading in 0.01 degrees, 0 to 35999."""
    heading = deg(yaw % _TURN) % deg(_TURN)
    return round(heading * 100) % round(deg(_TURN) * 100)


def wrapped(angle: float) -> float:
    """Return an angle (rad) wrapped to [-pi, pi]."""
    return math.remainder(angle, _TURN)


def turns(angle: float) -> float:
    """Convert an angle (rad) to turns."""
    return angle / _TURN


def milliseconds(t_ns: int) -> int:
    """Convert a simulation time to `time_boot_ms`."""
    return t_ns // 1_000_000


def microseconds(t_ns: int) -> int:
    """Convert a simulation time to `time_usec`."""
    return t_ns // 1000


def seconds(t_ns: int) -> float:
    """Convert nanoseconds to seconds."""
    return t_ns / NANOSECONDS


def nanoseconds(time_s: float) -> int:
    """Convert seconds to nanoseconds."""
    return round(time_s * NANOSECONDS)


def pulse(deflection: float) -> int:
    """Convert a deflection (-1 to 1) to a pulse width, us."""
    return round(NEUTRAL_US + SPAN_US * min(1.0, max(-1.0, deflection)))


def deflection(pulse_us: float) -> float:
    """Convert a pulse width (us) to a deflection, -1 to 1. Pulses outside 1100 to 1900 us are limited."""
    return min(1.0, max(-1.0, (pulse_us - NEUTRAL_US) / SPAN_US))


class Datum(Struct, frozen=True):
    """The place of N's origin on the Earth.

    N is the plane that touches the ellipsoid there, as for the world's GPS: z = 0 is the sea.

    Attributes:
        latitude, longitude: rad.
    """

    latitude: float
    longitude: float

    def geodetic(self, north: float, east: float) -> tuple[float, float]:
        """Return latitude and longitude (rad) of a point of the plane (m)."""
        return latitude_longitude(north, east, self.latitude, self.longitude)

    def north_east(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Return the point of the plane (m) below a latitude and longitude (rad): the inverse of `geodetic`."""
        north, east = north_east(np.array(latitude), np.array(longitude), self.latitude, self.longitude)
        return float(north), float(east)


def datum(latitude_deg: float, longitude_deg: float) -> Datum | None:
    """Return a place given in degrees, or None where there is no such place."""
    place = vector((latitude_deg, longitude_deg), 2)
    if place is None or abs(rad(place[0])) > math.pi / 2 or abs(rad(place[1])) > _TURN:
        return None
    return Datum(rad(place[0]), wrapped(rad(place[1])))


def turned(v: Vec3, yaw: float) -> Vec3:
    """Return in N a vector whose x points along the heading."""
    s, c = math.sin(yaw), math.cos(yaw)
    return (c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])
