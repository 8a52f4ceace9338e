"""The water that every force and sensor asks: density, gravity, temperature, pressure and current. The surface is the plane z = 0 of N."""

from __future__ import annotations

from dataclasses import dataclass

from uwserver.frames import Vec3


@dataclass(slots=True)
class Water:
    """A uniform body of water.

    Attributes:
        density: kg/m3.
        gravity: m/s2, along +z of N.
        temperature: degC.
        atmospheric_pressure: Pa at the surface.
        current: velocity of the water in N, m/s; the only value that changes during a run (service ``world/set_current``).
    """

    density: float
    gravity: float
    temperature: float
    atmospheric_pressure: float
    current: Vec3

    def pressure(self, z: float) -> float:
        """Absolute pressure (Pa) at depth z (m, positive down): hydrostatic below the surface, atmospheric above."""
        return self.atmospheric_pressure + self.density * self.gravity * max(0.0, z)
