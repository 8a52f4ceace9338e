"""The water of a world: its properties over depth, and pressure, velocity and surface as functions of place and time; with moving water (`Sea`),
its currents and waves as arrays for the kernel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType

import numpy as np

from uwserver.environment.column import WaterColumn, uniform_column
from uwserver.environment.currents import Drift
from uwserver.environment.light import WaterType
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import WAVE_AMPLITUDE, SeaRows


@cache
def _kernel() -> ModuleType:
    """Return the kernel module. It is imported at the first use, as numba takes half a second to load."""
    from uwserver.physics.dynamics import flow

    return flow


class Sea:
    """Currents and waves of a scenario that has more than a uniform, steady current. Not thread-safe.

    Attributes:
        rows: for the kernel; `uniform` is valid from the present tick to the next.
        drifts: the currents that change with time.
        ends: (k, 2, 3) velocities of these in N at the last and at the next draw, m/s; `Drift.ends` are views of it.
        intervals: (k) ticks from draw to draw of these.
    """

    def __init__(self, rows: SeaRows, drifts: Sequence[Drift] = (), dt: float = 1.0) -> None:
        """Make a sea at t = 0; `dt` is the length of a tick, s."""
        self.rows = rows
        self.drifts = tuple(drifts)
        self.ends: FloatArray = np.zeros((len(self.drifts), 2, 3))
        self.intervals: IntArray = np.array([drift.ticks for drift in self.drifts], np.int64)
        for drift, ends in zip(self.drifts, self.ends, strict=True):
            ends[...] = drift.ends
            drift.ends = ends
        self._dt = dt

    def draw(self, tick: int) -> None:
        """Draw the next velocities of the currents that begin an interval at a tick, which must follow the last one."""
        for drift in self.drifts:
            drift.move(tick)

    def hold(self, tick: int, t: float, steady: Vec3) -> None:
        """Set the uniform current of a tick that begins at t (s); `steady` is its steady part, m/s in N. While the world runs, compiled code does
        this (`uwserver.step.tick`)."""
        uniform = self.rows.uniform
        uniform[:3], uniform[3:6], uniform[6] = steady, 0.0, t
        for drift in self.drifts:
            velocity, step = drift.at(tick)
            uniform[:3] += velocity
            uniform[3:6] += step / self._dt

    @property
    def roughness(self) -> float:
        """Standard deviation of the elevation of the surface, m."""
        amplitude = self.rows.waves[:, WAVE_AMPLITUDE]
        return math.sqrt(0.5 * float(amplitude @ amplitude))

    def velocity(self, p: Vec3, t: float) -> Vec3:
        """Return the velocity of the water in N, m/s, at a point of N (m) and a time (s) within the present tick."""
        kernel = _kernel()
        u, v, w = self._at(p, t)[kernel.V : kernel.V + 3].tolist()
        return (u, v, w)

    def elevation(self, x: float, y: float, t: float) -> float:
        """Return the elevation of the surface above z = 0, m."""
        return float(self._at((x, y, 0.0), t)[_kernel().ELEVATION])

    def head(self, p: Vec3, t: float) -> float:
        """Return the dynamic pressure over density times gravity, m; above z = 0 the value at z = 0."""
        return float(self._at(p, t)[_kernel().HEAD])

    def _at(self, p: Vec3, t: float) -> FloatArray:
        point = np.empty(_kernel().POINT_SIZE)
        _kernel().water_at(self.rows, *p, t, point)
        return point


@dataclass(slots=True)
class Water:
    """The water of a world. Without `sea` it flows uniformly and steadily, and its surface is the plane z = 0 of N.

    Attributes:
        density: with which forces act, kg/m3.
        gravity: m/s2 at the surface, along +z of N.
        temperature: degC at the surface.
        atmospheric_pressure: Pa at the surface.
        current: steady part of the velocity in N, m/s; the only value here that changes during a run (``world/set_current``).
        sea: other currents, and waves.
        given: properties over depth; None for uniform water of this density and temperature.
        growth: relative growth of gravity with depth, 1/m.
        jerlov: water type, which gives its clarity.
        column: properties over depth: `given` or those of uniform water.
    """

    density: float
    gravity: float
    temperature: float
    atmospheric_pressure: float
    current: Vec3
    sea: Sea | None = None
    given: WaterColumn | None = None
    growth: float = 0.0
    jerlov: WaterType = "II"
    column: WaterColumn = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Fill in `column`."""
        self.column = self.given or uniform_column(self.density, self.temperature, self.gravity, self.growth)

    def gravity_at(self, depth: float) -> float:
        """Return gravity, m/s2, at a depth below z = 0 (m); above z = 0 that at the surface."""
        return self.gravity * (1.0 + self.growth * max(0.0, depth))

    def velocity(self, p: Vec3, t: float) -> Vec3:
        """Return the velocity of the water (m/s, N) at a point of N (m); t (s) is within the present tick."""
        return self.current if self.sea is None else self.sea.velocity(p, t)

    def elevation(self, x: float, y: float, t: float) -> float:
        """Return the elevation of the surface above z = 0 (m) at a place of N (m) and time t (s)."""
        return 0.0 if self.sea is None else self.sea.elevation(x, y, t)

    def pressure(self, p: Vec3, t: float) -> float:
        """Return the absolute pressure (Pa) at a point of N (m) and time t (s): hydrostatic plus that of waves, never below atmospheric.

        Linear theory is valid below z = 0. In a wave crest above it the pressure is hydrostatic from the surface down.
        """
        head = p[2] if self.sea is None else p[2] + self.sea.head(p, t)
        return self.atmospheric_pressure + self.column.pressure_at(head)

    def sound_speed(self, depth: float) -> float:
        """Return the speed of sound, m/s, at a depth below z = 0 (m)."""
        return self.column.sound_speed_at(depth)

    def absorption(self, frequency_Hz: float, depth: float) -> float:
        """Return the absorption of sound, dB/m, at a depth (m)."""
        return self.column.absorption_at(frequency_Hz, depth)

    def temperature_at(self, depth: float) -> float:
        """Return the temperature in situ, degC, at a depth (m)."""
        return self.column.temperature_at(depth)

    def salinity_at(self, depth: float) -> float:
        """Return the practical salinity at a depth (m)."""
        return self.column.salinity_at(depth)

    def density_at(self, depth: float) -> float:
        """Return the density in situ, kg/m3, at a depth (m)."""
        return self.column.density_at(depth)
