"""Places on the Earth for adapters: latitude and longitude to north and east of an origin, and back, on the ellipsoid WGS 84."""

from __future__ import annotations

from uwserver.environment.earth import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS, latitude_longitude, north_east

__all__ = ["ECCENTRICITY_SQUARED", "SEMI_MAJOR_AXIS", "latitude_longitude", "north_east"]
