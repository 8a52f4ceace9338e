"""Moving water: currents and waves as arrays for the kernel, their changes from tick to tick, and values at single points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from types import ModuleType

import numpy as np

from uwserver.environment.currents import Drift
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
