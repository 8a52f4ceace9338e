"""Computes the magnetic field about the origin of N by the World Magnetic Model, once at load."""

from __future__ import annotations

from uwserver.environment.geodesy import latitude_longitude
from uwserver.frames import Vec3
from uwserver.units import deg

WMM_YEARS = (2025, 2030)
"""First year of the model, and the first year after it."""
_TESLA = 1e-9
_STEP = 1000.0
"""Distance to each side over which the gradient is taken, m."""


def magnetic_about(latitude: float, longitude: float, year: float) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """Return `Earth.magnetic` by the World Magnetic Model, at mean sea level.

    Args:
        latitude, longitude: of the origin, rad.
        year: UTC, with its fraction; the model holds from 2025 to 2029.

    Raises:
        ValueError: the year is outside the model.
    """
    from pygeomag import GeoMag

    model = GeoMag(coefficients_file="wmm/WMM_2025.COF")

    def field(north: float, east: float, down: float) -> Vec3:
        lat, lon = latitude_longitude(north, east, latitude, longitude)
        found = model.calculate(glat=deg(lat), glon=deg(lon), alt=-down * 1e-3, time=year)
        return found.x * _TESLA, found.y * _TESLA, found.z * _TESLA

    at = field(0.0, 0.0, 0.0)
    slopes = []
    for x, y, z in ((_STEP, 0.0, 0.0), (0.0, _STEP, 0.0), (0.0, 0.0, _STEP)):
        ahead, behind = field(x, y, z), field(-x, -y, -z)
        slopes.append(tuple((a - b) / (2.0 * _STEP) for a, b in zip(ahead, behind, strict=True)))
    return at, slopes[0], slopes[1], slopes[2]  # type: ignore[return-value]  # three components each
