"""The rays of a narrow conical beam, whose echoes are heard as one."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.sensors.acoustic.imaging.fan import Grid, two_way
from uwserver.sensors.acoustic.imaging.swath import Swath

_FLANKS = 2.0


class Pencil(Swath):
    """One beam along x, of one column: the pattern of a round piston is taken as the product of those of two lines."""

    def __init__(self, width: float, side: int) -> None:
        """Lay out rays.

        Args:
            width: angle between half-power points of transmitter and receiver each, rad.
            side: square root of the number of rays.
        """
        self.columns, self.rows = 1, side * side
        self.grid = Grid.of(_FLANKS * width, _FLANKS * width, side, side)
        along = two_way(self.grid.elevation, width) * self.grid.areas()
        self.grid.cells["emitted"] = np.outer(along, two_way(self.grid.azimuth, width)).ravel()
        self.column: IntArray = np.zeros(side * side, np.int64)
        self.azimuth: FloatArray = np.zeros(1)
        self.pattern = self.power = np.ones((1, 1), np.float32)
        self.directivity = 4.0 * math.pi / (width * width)
        self.aperture = 0.886 / width
