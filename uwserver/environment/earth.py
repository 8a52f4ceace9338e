"""The Earth at the origin of N: geodetic coordinates (WGS 84) and their conversion to north and east, UTC, magnetic field (World Magnetic Model),
gravity and rotation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import FloatArray

SEMI_MAJOR_AXIS = 6_378_137.0
"""Of WGS84, m (NIMA TR8350.2)."""
_TURN = 2.0 * math.pi
ECCENTRICITY_SQUARED = 6.694_379_990_14e-3
NO_FIELD: tuple[Vec3, Vec3, Vec3, Vec3] = ((0.0, 0.0, 0.0),) * 4
"""Value of `Earth.magnetic` if nothing needs the field."""
EARTH_RATE = 7.292115e-5
"""Angular rate of the Earth, rad/s; WGS 84 (NIMA TR8350.2, table 3.1)."""
GRAVITY_GROWTH = 2.26e-7
"""Relative growth of gravity per metre of depth: free-air gradient less the attraction of the water above, as in TEOS-10 (gsw_grav)."""


def north_east(
    latitude: FloatArray, longitude: FloatArray, origin_latitude: float, origin_longitude: float
) -> tuple[FloatArray, FloatArray]:
    """Return north and east (m) of points on the ellipsoid, in its tangent plane at the origin; all angles in rad.

    These coordinates of the tangent plane are exact. A distance over the ground is longer by about d^3 / (6 R^2): 4 mm at 10 km, 4 m at 100 km.
    Depth is not affected: the sea surface is the plane z = 0, so z is the depth below the surface.
    """
    turn = np.remainder(longitude - origin_longitude + math.pi, 2.0 * math.pi) - math.pi
    s0, c0 = math.sin(origin_latitude), math.cos(origin_latitude)
    sines, cosines = np.sin(latitude), np.cos(latitude)
    across = SEMI_MAJOR_AXIS / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sines**2)
    across_0 = SEMI_MAJOR_AXIS / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s0**2)
    # Earth-centred coordinates, with the x axis through the meridian of the origin.
    x = across * cosines * np.cos(turn) - across_0 * c0
    z = (1.0 - ECCENTRICITY_SQUARED) * (across * sines - across_0 * s0)
    north: FloatArray = c0 * z - s0 * x
    east: FloatArray = across * cosines * np.sin(turn)
    return north, east


def latitude_longitude(
    north: float, east: float, origin_latitude: float, origin_longitude: float
) -> tuple[float, float]:
    """Return latitude and longitude (rad) of a point of the plane (m): the exact inverse of `north_east`; beyond the edge of the Earth those of
    the edge."""
    s, c = math.sin(origin_latitude), math.cos(origin_latitude)
    across = SEMI_MAJOR_AXIS / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s * s)
    flat = 1.0 - ECCENTRICITY_SQUARED
    # Earth-centred coordinates, with the x axis through the meridian of the origin: from the point of the plane down along its normal (c, 0, s) to
    # the ellipsoid.
    x, z = across * c - s * north, flat * across * s + c * north
    a, b = c * c + s * s / flat, c * x + s * z / flat
    gap = x * x + east * east + z * z / flat - SEMI_MAJOR_AXIS**2
    up = -gap / (b + math.sqrt(max(0.0, b * b - a * gap)))
    x, z = x + c * up, z + s * up
    longitude = origin_longitude + math.atan2(east, x)
    return math.atan2(z, flat * math.hypot(x, east)), longitude - _TURN * round(longitude / _TURN)


def normal_gravity(latitude: float) -> float:
    """Return gravity (m/s2) on the ellipsoid at a geodetic latitude (rad): Somigliana's closed form for WGS 84 (NIMA TR8350.2, eq. 4-1)."""
    square = math.sin(latitude) ** 2
    return 9.7803253359 * (1.0 + 0.00193185265241 * square) / math.sqrt(1.0 - ECCENTRICITY_SQUARED * square)


def turns_of_level(rate: Vec3, curvature: tuple[float, float], p: Vec3, v: Vec3) -> tuple[Vec3, Vec3]:
    """Return the inertial rotation of the level axes at a place: omega_ie, the Earth's rate, and omega_el, the transport rate (rad/s, both in N).

    N is used like a map: its axes stand for the level axes at p, which are turned against those at the origin by (y / R_E, -x / R_N, 0). The result
    is of first order in that angle; the error at 10 km is some 1e-6 of the Earth's rate.

    Args:
        rate: rate of the Earth at the origin, in N.
        curvature: curvature of the ellipsoid to the north and to the east, 1/m.
        p, v: place and velocity in N, m and m/s.
    """
    a, b = p[1] * curvature[1], -p[0] * curvature[0]
    x, y, z = rate
    return (x - b * z, y + a * z, z - a * y + b * x), (v[1] * curvature[1], -v[0] * curvature[0], 0.0)


@dataclass(frozen=True, slots=True)
class Earth:
    """The Earth around the origin of N.

    N is the tangent plane of the ellipsoid at the origin, and z = 0 is the sea. Latitude and longitude of a point are those of the point on the
    ellipsoid vertically below its place in the plane, and its height is -z.

    Attributes:
        latitude, longitude: those of the origin, rad.
        epoch_ns: UTC of t = 0, ns since 1970.
        magnetic: field at the origin in N, and its gradient to the north, east and down (T, T/m).
        rotating: whether the Earth rotates and is round; else N is an inertial frame.
    """

    latitude: float = 0.0
    longitude: float = 0.0
    epoch_ns: int = 0
    magnetic: tuple[Vec3, Vec3, Vec3, Vec3] = NO_FIELD
    rotating: bool = False

    def geodetic(self, p: Vec3) -> Vec3:
        """Return latitude, longitude (rad) and height (m) of a point of N (m)."""
        latitude, longitude = latitude_longitude(p[0], p[1], self.latitude, self.longitude)
        return latitude, longitude, -p[2]

    def magnetic_field(self, p: Vec3) -> Vec3:
        """Return the field in N (T) at a point of N (m), linear about the origin; good for some ten kilometres."""
        at, north, east, down = self.magnetic
        x, y, z = p
        return (
            at[0] + north[0] * x + east[0] * y + down[0] * z,
            at[1] + north[1] * x + east[1] * y + down[1] * z,
            at[2] + north[2] * x + east[2] * y + down[2] * z,
        )

    @property
    def rate(self) -> Vec3:
        """The Earth's rate at the origin, rad/s in N; zero unless it rotates."""
        rate = EARTH_RATE if self.rotating else 0.0
        return rate * math.cos(self.latitude), 0.0, -rate * math.sin(self.latitude)

    @property
    def curvature(self) -> tuple[float, float]:
        """Curvature of the ellipsoid at the origin to the north and to the east, 1/m; zero unless the Earth rotates."""
        if not self.rotating:
            return 0.0, 0.0
        square = 1.0 - ECCENTRICITY_SQUARED * math.sin(self.latitude) ** 2
        across = math.sqrt(square) / SEMI_MAJOR_AXIS
        return across * square / (1.0 - ECCENTRICITY_SQUARED), across

    @property
    def declination(self) -> float:
        """Magnetic declination at the origin, rad, positive east."""
        return math.atan2(self.magnetic[0][1], self.magnetic[0][0])
