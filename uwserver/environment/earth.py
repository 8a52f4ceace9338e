"""Where on the Earth the origin of N lies: geodetic coordinates (WGS 84), UTC, and the magnetic field (World Magnetic Model)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uwserver.frames import Vec3
from uwserver.units import deg

_A, _F = 6_378_137.0, 1.0 / 298.257223563
_E2 = _F * (2.0 - _F)
_B = _A * (1.0 - _F)
_TESLA = 1e-9
_STEP = 1000.0
"""Distance (m) over which the gradient of the magnetic field is taken."""
WMM_YEARS = (2025, 2030)
"""First year of the World Magnetic Model in use, and the one that it no longer holds for."""
NO_FIELD: tuple[Vec3, Vec3, Vec3, Vec3] = ((0.0, 0.0, 0.0),) * 4


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


def magnetic_about(latitude: float, longitude: float, year: float) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """`Earth.magnetic` of the World Magnetic Model, at mean sea level.

    Args:
        latitude, longitude: of the origin, rad.
        year: UTC, with its fraction; the model holds for 2025 to 2029.

    Raises:
        ValueError: the year is outside the model.
    """
    from pygeomag import GeoMag

    model = GeoMag(coefficients_file="wmm/WMM_2025.COF")

    def field(north: float, east: float, down: float) -> Vec3:
        lat, lon = geodetic_of(latitude, longitude, north, east)
        found = model.calculate(glat=deg(lat), glon=deg(lon), alt=-down * 1e-3, time=year)
        return found.x * _TESLA, found.y * _TESLA, found.z * _TESLA

    at = field(0.0, 0.0, 0.0)
    slopes = []
    for axis in range(3):
        ahead, behind = field(*_step(axis, _STEP)), field(*_step(axis, -_STEP))
        slopes.append(tuple((a - b) / (2.0 * _STEP) for a, b in zip(ahead, behind, strict=True)))
    return at, slopes[0], slopes[1], slopes[2]  # type: ignore[return-value]  # three components each


def _step(axis: int, length: float) -> Vec3:
    step = [0.0, 0.0, 0.0]
    step[axis] = length
    return step[0], step[1], step[2]
