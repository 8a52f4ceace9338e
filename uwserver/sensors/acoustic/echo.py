"""What echo sounders of every kind share: rays against solids and the sea surface, backscatter, and the level of an echo.

The sea surface is a function, not a mesh: seen from below it reflects like a very rough bottom.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType

import numpy as np

from uwserver.environment.materials import SEDIMENT_DB, SURFACE_DB
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import SURFACE, Geometry, Hits
from uwserver.sensors.base import Scope

MU_SURFACE = 10.0 ** (0.1 * SURFACE_DB)
MU_SEDIMENT = 10.0 ** (0.1 * SEDIMENT_DB)


@cache
def kernels() -> tuple[ModuleType, ModuleType]:
    """`echoes` and `hits` of physics. Imported when they are needed, as numba takes half a second."""
    from uwserver.physics.rays import echoes, hits

    return echoes, hits


def load_kernels() -> None:
    """Load them, or compile them, now rather than in the first reading."""
    from uwserver.physics.warm import echo_kernels

    echo_kernels()


def cast_from(geometry: Geometry, origin: Vec3, height: float, direction: FloatArray, max_range: float) -> Hits:
    """The first solid or piece of sea surface that each ray meets, from a point under water.

    The surface is taken as level.

    Args:
        geometry: solid things at the instant.
        origin: in N, m.
        height: of the surface above the origin, m.
        direction: (n, 3) unit, in N.
        max_range: m; farther things are not seen.
    """
    origins = np.empty(direction.shape)
    origins[:] = origin
    found = geometry.raycast(origins, direction, max_range)
    kernels()[1].intersect_level(height, direction, max_range, SURFACE, *found)
    return found


class Absorption:
    """Absorption of sound of one frequency, dB/m, by metres of depth: it changes so little that an instrument asks once a metre.

    Only for one world, whose water it remembers.
    """

    def __init__(self, frequency_Hz: float) -> None:
        self._frequency = frequency_Hz
        self._known: dict[int, float] = {}

    def at(self, scope: Scope, z: float) -> float:
        """dB/m at a depth z (m)."""
        depth = round(z)
        if depth not in self._known:
            self._known[depth] = scope.water.absorption(self._frequency, float(depth))
        return self._known[depth]
