"""What sensors and the contact solver may ask about solid things. No engine is imported here; it is chosen at load."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, IntArray

NOTHING = -1
SURFACE = -2
"""Id of the sea surface, which is no solid. Sensors use it as body and as material of a hit."""


class Hits(NamedTuple):
    """The first thing that each ray meets.

    Attributes:
        distance: (n) m; inf where nothing is hit.
        normal: (n, 3) outward unit normal in N; zeros where nothing is hit.
        body: (n) id of the solid; -1 if nothing is hit.
        material: (n) number of its material; -1 if nothing is hit.
    """

    distance: FloatArray
    normal: FloatArray
    body: IntArray
    material: IntArray


class Geometry(Protocol):
    """Solid things at one instant."""

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Cast rays.

        Args:
            origin: (n, 3) starts in N, m.
            direction: (n, 3) unit directions in N.
            max_range: m; things beyond it are not hit.

        Returns:
            Arrays that the caller may change.
        """


def no_hits(n: int) -> Hits:
    """Return the answer for n rays that meet nothing. Its arrays may be filled in."""
    nothing = np.full(n, -1, dtype=np.int64)
    return Hits(np.full(n, np.inf), np.zeros((n, 3)), nothing, nothing.copy())


class OpenWater:
    """A world without anything solid."""

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Return that nothing is hit."""
        return no_hits(len(origin))
