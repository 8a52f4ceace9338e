"""What sensors may ask of solid things. The engine behind it is chosen at load; nothing here imports one."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Hits(NamedTuple):
    """First thing that each ray meets.

    Attributes:
        distance: (n) m; inf where nothing is hit.
        normal: (n, 3) outward unit normal in N; zeros where nothing is hit.
        body: (n) id of what is hit; -1 for nothing.
    """

    distance: FloatArray
    normal: FloatArray
    body: IntArray


class Geometry(Protocol):
    """Solid things at one instant."""

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Cast rays.

        Args:
            origin: (n, 3) starts in N, m.
            direction: (n, 3) unit directions in N.
            max_range: m; farther things are not seen.
        """


class OpenWater:
    """A world without anything solid."""

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Nothing is hit."""
        n = len(origin)
        return Hits(np.full(n, np.inf), np.zeros((n, 3)), np.full(n, -1, dtype=np.int64))
