"""Where on the Earth the origin of N lies: geodetic coordinates (WGS 84), UTC, and the magnetic field (World Magnetic Model)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uwserver.frames import Vec3

_A, _F = 6_378_137.0, 1.0 / 298.257223563
_E2 = _F * (2.0 - _F)
_B = _A * (1.0 - _F)
NO_FIELD: tuple[Vec3, Vec3, Vec3, Vec3] = ((0.0, 0.0, 0.0),) * 4
"""`Earth.magnetic` where nothing asks for it."""


@dataclass(frozen=True, slots=True)
class Earth:
    """The Earth around the origin of N.

    N is the plane that touches the ellipsoid there, and its z = 0 is the sea: far away the plane would leave the ellipsoid, so latitude and
    longitude are those below the point in the plane, and the height is -z.

    Attributes:
        latitude, longitude: of the origin, rad.
        epoch_ns: UTC of t = 0, ns since 1970.
        magnetic: field at the origin in N, and its change per metre north, east and down (T, T/m).
    """

    latitude: float = 0.0
    longitude: float = 0.0
    epoch_ns: int = 0
    magnetic: tuple[Vec3, Vec3, Vec3, Vec3] = NO_FIELD

    def geodetic(self, p: Vec3) -> Vec3:
        """Latitude, longitude (rad) and height (m) of a point of N (m)."""
        latitude, longitude = geodetic_of(self.latitude, self.longitude, p[0], p[1])
        return latitude, longitude, -p[2]

    def magnetic_field(self, p: Vec3) -> Vec3:
        """Field in N (T) at a point of N (m): linear about the origin, good for some ten kilometres."""
        at, north, east, down = self.magnetic
        x, y, z = p
        return (
            at[0] + north[0] * x + east[0] * y + down[0] * z,
            at[1] + north[1] * x + east[1] * y + down[1] * z,
            at[2] + north[2] * x + east[2] * y + down[2] * z,
        )

    @property
    def declination(self) -> float:
        """Magnetic declination at the origin, rad, positive east."""
        return math.atan2(self.magnetic[0][1], self.magnetic[0][0])


def geodetic_of(latitude: float, longitude: float, north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude (rad) of a point in the plane that touches the ellipsoid at (latitude, longitude).

    Through earth-centred coordinates; back by Bowring's formula, which near the ellipsoid errs by less than a nanometre.
    """
    s, c = math.sin(latitude), math.cos(latitude)
    normal = _A / math.sqrt(1.0 - _E2 * s * s)
    radial = normal * c - s * north
    z = normal * (1.0 - _E2) * s + c * north
    across = math.hypot(radial, east)
    beta = math.atan2(z * _A, across * _B)
    for _ in range(2):
        fitted = math.atan2(z + _E2 / (1.0 - _E2) * _B * math.sin(beta) ** 3, across - _E2 * _A * math.cos(beta) ** 3)
        beta = math.atan2((1.0 - _F) * math.sin(fitted), math.cos(fitted))
    turned = longitude + math.atan2(east, radial)
    return fitted, math.remainder(turned, 2.0 * math.pi)
