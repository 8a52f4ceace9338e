"""The vehicle's place on the Earth: the origin of N, home, and places that ground stations send."""

from __future__ import annotations

from msgspec import Struct

from uwserver.frames import Vec3
from uwserver_adapters.mavlink.wire.codec import Datum, datum, degrees_e7, from_degrees_e7
from uwserver_adapters.mavlink.wire.dialect import Fields


class Place(Struct, frozen=True):
    """Latitude and longitude (rad), and altitude above the sea (m)."""

    latitude: float
    longitude: float
    altitude: float = 0.0


class Home:
    """Origin of N and home. Both are unknown until the scenario or a ground station sets them.

    Args:
        origin_deg: latitude and longitude of N's origin.

    Raises:
        ValueError: there is no such place.

    Attributes:
        origin: origin of N, at sea level.
        home: what relative altitudes refer to; the sea above the origin unless set.
    """

    def __init__(self, origin_deg: tuple[float, float] | None) -> None:
        self.origin: Datum | None = None if origin_deg is None else datum(*origin_deg)
        self.home: Place | None = None
        if origin_deg is not None and self.origin is None:
            raise ValueError(f"origin_deg = {list(origin_deg)}: write latitude, longitude, in degrees")
        self._home_at_origin()

    def _home_at_origin(self) -> None:
        if self.origin is not None and self.home is None:
            self.home = Place(self.origin.latitude, self.origin.longitude)

    def set_origin(self, latitude_e7: float, longitude_e7: float) -> bool:
        """Set the origin, in 1e-7 degrees. Returns False when it is already known, or there is no such place."""
        if self.origin is not None:
            return False
        self.origin = datum(latitude_e7 / 1e7, longitude_e7 / 1e7)
        self._home_at_origin()
        return self.origin is not None

    def place(self, p_N: Vec3) -> Place | None:
        """Return the place of a point of N."""
        if self.origin is None:
            return None
        latitude, longitude = self.origin.geodetic(p_N[0], p_N[1])
        return Place(latitude, longitude, -p_N[2])

    def point(self, latitude_e7: float, longitude_e7: float, altitude: float, is_relative: bool) -> Vec3 | None:
        """Return the point of N at a place.

        Args:
            latitude_e7, longitude_e7: 1e-7 degrees.
            altitude: m, above the sea or above home.
            is_relative: whether the altitude is above home.

        Returns:
            None without an origin, or where there is no such place.
        """
        there = datum(latitude_e7 / 1e7, longitude_e7 / 1e7)
        if self.origin is None or there is None:
            return None
        north, east = self.origin.north_east(there.latitude, there.longitude)
        return (north, east, -self.sea_altitude(altitude, is_relative))

    def sea_altitude(self, altitude: float, is_relative: bool) -> float:
        """Return the altitude above the sea (m) of an altitude above the sea or above home."""
        return altitude + (self.home.altitude if is_relative and self.home is not None else 0.0)

    def home_position(self, time_usec: int) -> Fields | None:
        """Return the fields of HOME_POSITION."""
        if self.home is None or self.origin is None:
            return None
        north, east = self.origin.north_east(self.home.latitude, self.home.longitude)
        return {
            "latitude": degrees_e7(self.home.latitude),
            "longitude": degrees_e7(self.home.longitude),
            "altitude": self.home.altitude * 1e3,
            "x": north,
            "y": east,
            "z": -self.home.altitude,
            "q": (1.0, 0.0, 0.0, 0.0),
            "time_usec": time_usec,
        }

    def global_origin(self, time_usec: int) -> Fields | None:
        """Return the fields of GPS_GLOBAL_ORIGIN."""
        if self.origin is None:
            return None
        return {
            "latitude": degrees_e7(self.origin.latitude),
            "longitude": degrees_e7(self.origin.longitude),
            "time_usec": time_usec,
        }


def place_of_e7(latitude_e7: float, longitude_e7: float, altitude: float) -> Place | None:
    """Return a place given in 1e-7 degrees and m, or None where there is no such place."""
    if datum(latitude_e7 / 1e7, longitude_e7 / 1e7) is None:
        return None
    return Place(from_degrees_e7(latitude_e7), from_degrees_e7(longitude_e7), altitude)
