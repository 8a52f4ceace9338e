"""What sensors and the contact solver may ask of solid things. The engines behind it are chosen at load; nothing here imports one."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, IntArray

NOTHING = -1
SURFACE = -2
"""Id of the sea surface, which is no solid: sensors give it, as body and as material of a hit."""


class Hits(NamedTuple):
    """First thing that each ray meets.

    Attributes:
        distance: (n) m; inf where nothing is hit.
        normal: (n, 3) outward unit normal in N; zeros where nothing is hit.
        body: (n) id of what is hit; -1 for nothing.
        material: (n) number of its material; -1 for nothing.
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
            max_range: m; farther things are not hit.

        Returns:
            Arrays that are the caller's to change.
        """


def no_hits(n: int) -> Hits:
    """The answer to n rays that meet nothing; its arrays may be filled in."""
    nothing = np.full(n, -1, dtype=np.int64)
    return Hits(np.full(n, np.inf), np.zeros((n, 3)), nothing, nothing.copy())


class OpenWater:
    """A world without anything solid."""

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Nothing is hit."""
        return no_hits(len(origin))
