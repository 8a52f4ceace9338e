"""Water that moves: currents and waves as arrays for the kernel, what changes in them from tick to tick, and answers at single points."""

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
    """Loaded at the first question, as numba takes half a second."""
    from uwserver.physics.dynamics import flow

    return flow


class Sea:
    """Currents and waves of a scenario that has more than a uniform, steady current. Not thread-safe.

    Attributes:
        rows: for the kernel; `uniform` holds from the present tick to the next.
        drifts: the currents that change with time.
        ends: (k, 2, 3) of these: velocity in N at the last and at the next draw, m/s; views of it stand in each.
        intervals: (k) ticks from draw to draw.
    """

    def __init__(self, rows: SeaRows, drifts: Sequence[Drift] = (), dt: float = 1.0) -> None:
        """A sea at t = 0; dt: s a tick."""
        self.rows = rows
        self.drifts = tuple(drifts)
        self.ends: FloatArray = np.zeros((len(self.drifts), 2, 3))
        self.intervals: IntArray = np.array([drift.ticks for drift in self.drifts], np.int64)
        for drift, ends in zip(self.drifts, self.ends, strict=True):
            ends[...] = drift.ends
            drift.ends = ends
        self._dt = dt

    def draw(self, tick: int) -> None:
        """Draw the next velocities of those currents that begin an interval in a tick, one after the last one."""
        for drift in self.drifts:
            drift.move(tick)

    def hold(self, tick: int, t: float, steady: Vec3) -> None:
        """Set the uniform part of a tick that begins now, at t (s); `steady`: its steady part, m/s in N. From tick to tick compiled code does it
        (`uwserver.step.tick`)."""
        uniform = self.rows.uniform
        uniform[:3], uniform[3:6], uniform[6] = steady, 0.0, t
        for drift in self.drifts:
            velocity, step = drift.at(tick)
            uniform[:3] += velocity
            uniform[3:6] += step / self._dt

    @property
    def roughness(self) -> float:
        """Standard deviation of the surface's elevation, m."""
        amplitude = self.rows.waves[:, WAVE_AMPLITUDE]
        return math.sqrt(0.5 * float(amplitude @ amplitude))

    def velocity(self, p: Vec3, t: float) -> Vec3:
        """Of the water in N, m/s, at a point of N (m) and a time (s) in the present tick."""
        kernel = _kernel()
        u, v, w = self._at(p, t)[kernel.V : kernel.V + 3].tolist()
        return (u, v, w)

    def elevation(self, x: float, y: float, t: float) -> float:
        """Of the surface above z = 0, m."""
        return float(self._at((x, y, 0.0), t)[_kernel().ELEVATION])

    def head(self, p: Vec3, t: float) -> float:
        """Dynamic pressure over density times gravity, m; above z = 0 that at z = 0."""
        return float(self._at(p, t)[_kernel().HEAD])

    def _at(self, p: Vec3, t: float) -> FloatArray:
        point = np.empty(_kernel().POINT_SIZE)
        _kernel().water_at(self.rows, *p, t, point)
        return point
