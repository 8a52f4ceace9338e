"""Places on the Earth for adapters: latitude and longitude to north and east of an origin, and back, on the WGS 84 ellipsoid."""

from __future__ import annotations

from uwserver.environment.geodesy import latitude_longitude, north_east

__all__ = ["latitude_longitude", "north_east"]
