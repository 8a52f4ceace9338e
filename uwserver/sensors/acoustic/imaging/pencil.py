"""The rays of a narrow conical beam, whose echoes are heard as one."""

from __future__ import annotations

import math

import numpy as np

from uwserver.sensors.acoustic.imaging.fan import Grid, two_way

_FLANKS = 2.0


class Pencil:
    """One beam along x: the pattern of a round piston is taken as the product of those of two lines.

    Attributes:
        grid: its cells; `emitted` is the pattern of transmitter and receiver, times the solid angle (sr).
        directivity: of the receiver, as a ratio.
    """

    def __init__(self, width: float, side: int) -> None:
        """Lay out rays.

        Args:
            width: angle between half-power points of transmitter and receiver each, rad.
            side: square root of the number of rays.
        """
        self.grid = Grid.of(_FLANKS * width, _FLANKS * width, side, side)
        along = two_way(self.grid.elevation, width) * self.grid.areas()
        self.grid.cells["emitted"] = np.outer(along, two_way(self.grid.azimuth, width)).ravel()
        self.directivity = 4.0 * math.pi / (width * width)
