"""Where on the Earth the origin of N lies: geodetic coordinates (WGS 84), UTC, and the magnetic field (World Magnetic Model)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uwserver.environment.geodesy import latitude_longitude
from uwserver.frames import Vec3

NO_FIELD: tuple[Vec3, Vec3, Vec3, Vec3] = ((0.0, 0.0, 0.0),) * 4
"""`Earth.magnetic` where nothing asks for it."""


@dataclass(frozen=True, slots=True)
class Earth:
    """The Earth around the origin of N.

    N is the plane that touches the ellipsoid there, and its z = 0 is the sea: latitude and longitude are those of the point on the ellipsoid
    under the point of the plane, and the height is -z.

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
        latitude, longitude = latitude_longitude(p[0], p[1], self.latitude, self.longitude)
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
