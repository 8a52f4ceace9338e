"""The water that every sensor asks: density, gravity, temperature, and pressure, velocity and surface as functions of place and time."""

from __future__ import annotations

from dataclasses import dataclass

from uwserver.environment.sea import Sea
from uwserver.frames import Vec3


@dataclass(slots=True)
class Water:
    """A body of water. Without `sea` it flows uniformly and steadily, and its surface is the plane z = 0 of N.

    Attributes:
        density: kg/m3.
        gravity: m/s2, along +z of N.
        temperature: degC.
        atmospheric_pressure: Pa at the surface.
        current: steady part of the water's velocity in N, m/s; the only value here that changes during a run (``world/set_current``).
        sea: other currents, and waves.
    """

    density: float
    gravity: float
    temperature: float
    atmospheric_pressure: float
    current: Vec3
    sea: Sea | None = None

    def velocity(self, p: Vec3, t: float) -> Vec3:
        """Velocity of the water (m/s, N) at a point of N (m); t (s) in the present tick."""
        return self.current if self.sea is None else self.sea.velocity(p, t)

    def elevation(self, x: float, y: float, t: float) -> float:
        """Elevation of the surface above z = 0 (m) at a place of N (m) and time t (s)."""
        return 0.0 if self.sea is None else self.sea.elevation(x, y, t)

    def pressure(self, p: Vec3, t: float) -> float:
        """Absolute pressure (Pa) at a point of N (m) and time t (s): hydrostatic plus that of the waves, never below atmospheric.

        Linear theory holds below z = 0. In a crest above it the pressure is hydrostatic from the surface down.
        """
        head = p[2] if self.sea is None else p[2] + self.sea.head(p, t)
        return self.atmospheric_pressure + self.density * self.gravity * max(0.0, head)
