"""Units of MAVLink from and to SI and N: scaled integers, degrees, pulses, and the ellipsoid. Range is the message's business (`dialect.py`)."""

from __future__ import annotations

import math

from msgspec import Struct

from uwserver.frames import Vec3
from uwserver.units import NANOSECONDS, STANDARD_ATMOSPHERE_PA, deg, rad

_TURN = 2 * math.pi
_SEMI_MAJOR_M = 6_378_137.0
_ECCENTRICITY_2 = 6.694_379_990_14e-3
"""Ellipsoid WGS 84."""
_DEG_E7 = 1e7
_ABSURD = 1e30
NEUTRAL_US, SPAN_US = 1500, 400
"""Pulse at rest, and its change at full deflection."""
STANDARD_GRAVITY = 9.80665
"""m/s^2 in a g."""
STANDARD_ATMOSPHERE = STANDARD_ATMOSPHERE_PA
"""Pa."""


def finite(value: object) -> float | None:
    """A number that is one, else None; nothing real is as large as 1e30, and its thousandfold must be a number too."""
    return float(value) if isinstance(value, int | float) and abs(value) < _ABSURD else None


def vector(value: object, size: int) -> tuple[float, ...] | None:
    """So many finite numbers, else None."""
    if not isinstance(value, tuple | list) or len(value) != size:
        return None
    numbers = [finite(entry) for entry in value]
    return None if None in numbers else tuple(number for number in numbers if number is not None)


def vec3(value: object) -> Vec3 | None:
    """Three finite numbers, else None."""
    row = vector(value, 3)
    return None if row is None else (row[0], row[1], row[2])


def degrees_e7(angle: float) -> float:
    """Radians to 1e-7 degrees."""
    return deg(angle) * _DEG_E7


def from_degrees_e7(scaled: float) -> float:
    """1e-7 degrees to radians."""
    return rad(scaled / _DEG_E7)


def from_degrees(angle: float) -> float:
    """Degrees to radians."""
    return rad(angle)


def degrees(angle: float) -> float:
    """Radians to degrees."""
    return deg(angle)


def compass(yaw: float) -> float:
    """Heading, degrees in [0, 360), of a yaw angle (rad)."""
    return deg(yaw % _TURN) % deg(_TURN)


def compass_centidegrees(yaw: float) -> int:
    """The same in 0.01 degrees, 0 to 35999."""
    return round(compass(yaw) * 100) % round(deg(_TURN) * 100)


def wrapped(angle: float) -> float:
    """An angle (rad) in [-pi, pi]."""
    return math.remainder(angle, _TURN)


def turns(angle: float) -> float:
    """An angle (rad) in whole turns."""
    return angle / _TURN


def milliseconds(t_ns: int) -> int:
    """Simulation time as `time_boot_ms`."""
    return t_ns // 1_000_000


def microseconds(t_ns: int) -> int:
    """Simulation time as `time_usec`."""
    return t_ns // 1000


def seconds(t_ns: int) -> float:
    """Nanoseconds to seconds."""
    return t_ns / NANOSECONDS


def nanoseconds(time_s: float) -> int:
    """Seconds to nanoseconds."""
    return round(time_s * NANOSECONDS)


def pulse(deflection: float) -> int:
    """Microseconds of a deflection -1..1."""
    return round(NEUTRAL_US + SPAN_US * min(1.0, max(-1.0, deflection)))


def deflection(pulse_us: float) -> float:
    """-1..1 of a pulse; what is outside 1100 to 1900 us is as far as it goes."""
    return min(1.0, max(-1.0, (pulse_us - NEUTRAL_US) / SPAN_US))


class Datum(Struct, frozen=True):
    """Where the origin of N lies.

    N is the plane that touches the ellipsoid there, as for the world's GPS: z = 0 is the sea.

    Attributes:
        latitude, longitude: rad.
    """

    latitude: float
    longitude: float

    def geodetic(self, north: float, east: float) -> tuple[float, float]:
        """Latitude and longitude (rad) of a point of the plane (m)."""
        s, c = math.sin(self.latitude), math.cos(self.latitude)
        across, flat = self._across(s), 1.0 - _ECCENTRICITY_2
        # Earth-centred, x through the origin's meridian; from the point down the normal of the plane to the ellipsoid.
        x, z = across * c - s * north, flat * across * s + c * north
        a, b = c * c + s * s / flat, c * x + s * z / flat
        gap = x * x + east * east + z * z / flat - _SEMI_MAJOR_M**2
        up = -gap / (b + math.sqrt(max(0.0, b * b - a * gap)))
        x, z = x + c * up, z + s * up
        return math.atan2(z, flat * math.hypot(x, east)), wrapped(self.longitude + math.atan2(east, x))

    def north_east(self, latitude: float, longitude: float) -> tuple[float, float]:
        """The inverse: point of the plane (m) under latitude and longitude (rad)."""
        s, c = math.sin(self.latitude), math.cos(self.latitude)
        across, there = self._across(s), self._across(math.sin(latitude))
        turn = wrapped(longitude - self.longitude)
        x = there * math.cos(latitude) * math.cos(turn) - across * c
        z = (1.0 - _ECCENTRICITY_2) * (there * math.sin(latitude) - across * s)
        return c * z - s * x, there * math.cos(latitude) * math.sin(turn)

    @staticmethod
    def _across(sine: float) -> float:
        return _SEMI_MAJOR_M / math.sqrt(1.0 - _ECCENTRICITY_2 * sine * sine)


def datum(latitude_deg: float, longitude_deg: float) -> Datum | None:
    """A place on the Earth given in degrees; None when it is none."""
    place = vector((latitude_deg, longitude_deg), 2)
    if place is None or abs(rad(place[0])) > math.pi / 2 or abs(rad(place[1])) > _TURN:
        return None
    return Datum(rad(place[0]), wrapped(rad(place[1])))


def turned(v: Vec3, yaw: float) -> Vec3:
    """A vector with x along the heading, in N."""
    s, c = math.sin(yaw), math.cos(yaw)
    return (c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])
