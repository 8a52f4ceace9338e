"""The water that every force and sensor asks: density, gravity, temperature, pressure and current. The surface is the plane z = 0 of N."""

from __future__ import annotations

from dataclasses import dataclass, field

from uwserver.environment.column import WaterColumn, uniform_column
from uwserver.frames import Vec3


@dataclass(slots=True)
class Water:
    """A body of water.

    Attributes:
        density: kg/m3, which forces act with.
        gravity: m/s2, along +z of N.
        temperature: degC at the surface.
        atmospheric_pressure: Pa at the surface.
        current: velocity of the water in N, m/s; the only value that changes during a run (service ``world/set_current``).
        given: the water over depth; default: uniform water of this density and temperature.
        column: what is used of the two.
    """

    density: float
    gravity: float
    temperature: float
    atmospheric_pressure: float
    current: Vec3
    given: WaterColumn | None = None
    column: WaterColumn = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Without a column the water is uniform."""
        self.column = self.given or uniform_column(self.density, self.temperature, self.gravity)

    def pressure(self, z: float) -> float:
        """Absolute pressure (Pa) at depth z (m, positive down): hydrostatic below the surface, atmospheric above."""
        return self.atmospheric_pressure + self.column.pressure_at(z)

    def sound_speed(self, depth: float) -> float:
        """Speed of sound, m/s, at a depth below z = 0 (m)."""
        return self.column.sound_speed_at(depth)

    def absorption(self, frequency_Hz: float, depth: float) -> float:
        """Absorption of sound, dB/m."""
        return self.column.absorption_at(frequency_Hz, depth)

    def temperature_at(self, depth: float) -> float:
        """Temperature in situ, degC."""
        return self.column.temperature_at(depth)

    def salinity_at(self, depth: float) -> float:
        """Practical salinity."""
        return self.column.salinity_at(depth)

    def density_at(self, depth: float) -> float:
        """Density in situ, kg/m3."""
        return self.column.density_at(depth)
