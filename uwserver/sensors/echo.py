"""What echo sounders of every kind share: rays against solids and the sea surface, backscatter, and the level of an echo.

The sea surface is a function, not a mesh: seen from below it reflects like a very rough bottom.
"""

from __future__ import annotations

import numpy as np

from uwserver.environment.materials import SEDIMENT_DB, SURFACE_DB
from uwserver.frames import Quat, Vec3
from uwserver.physics.geometry import FloatArray, Hits
from uwserver.sensors.base import Scope

NOTHING = -1
SURFACE = -2
"""Id of the sea surface, as `body` and as `material` of a hit."""

MU_SURFACE = 10.0 ** (0.1 * SURFACE_DB)
MU_SEDIMENT = 10.0 ** (0.1 * SEDIMENT_DB)
_LEAST_GRAZING = 0.01
"""Sine below which backscatter falls no further: no bottom is that flat."""


def turn(q_NS: Quat) -> FloatArray:
    """R_NS (3, 3) of a unit quaternion."""
    w, x, y, z = q_NS
    return np.array(
        (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )
    )


def submergence(scope: Scope, p: Vec3) -> float:
    """How far a point of N is below the sea surface above it, m; negative in the air."""
    return p[2] + scope.water.elevation(p[0], p[1], scope.t)


def cast(scope: Scope, origin: Vec3, direction: FloatArray, max_range: float) -> Hits:
    """The first solid or piece of sea surface that each ray meets, from a point under water.

    The surface is taken as level, as high as above the origin.

    Args:
        scope: the instant.
        origin: in N, m.
        direction: (n, 3) unit, in N.
        max_range: m; farther things are not seen.
    """
    origins = np.empty(direction.shape)
    origins[:] = origin
    hits = scope.geometry.raycast(origins, direction, max_range)
    up = direction[:, 2]
    if up.min() >= 0.0:
        return hits
    with np.errstate(divide="ignore"):
        to_surface = np.where(up < 0.0, -submergence(scope, origin) / up, np.inf)
    nearer = (to_surface < hits.distance) & (to_surface <= max_range)
    if not nearer.any():
        return hits
    return Hits(
        np.where(nearer, to_surface, hits.distance),
        np.where(nearer[:, None], (0.0, 0.0, 1.0), hits.normal),
        np.where(nearer, SURFACE, hits.body),
        np.where(nearer, SURFACE, hits.material),
    )


def scattering(scope: Scope, hits: Hits, direction: FloatArray) -> FloatArray:
    """(n) intensity that a square metre of what each ray hits scatters back at 1 m, per unit of incident intensity: Lambert's law.

    Args:
        scope: knows the materials.
        hits: of the rays; nothing comes back from a miss.
        direction: (n, 3) of the rays.
    """
    sine = np.abs(np.einsum("ij,ij->i", hits.normal, direction))
    result: FloatArray = lambert_of(scope, hits) * np.maximum(sine, _LEAST_GRAZING) ** 2
    return result


def lambert_of(scope: Scope, hits: Hits) -> FloatArray:
    """(n) Lambert's parameter of what each ray hits, linear; 0 for a miss."""
    # A material that nobody named is taken for the last one: a sensor is no place to fail.
    mu = scope.lambert[np.minimum(np.maximum(hits.material, 0), len(scope.lambert) - 1)]
    mu[hits.body == SURFACE] = MU_SURFACE
    mu[hits.body == NOTHING] = 0.0
    return mu


def scattering_of_each(scope: Scope, hits: Hits, direction: FloatArray) -> list[float]:
    """`scattering` for a handful of rays, without the price of arrays."""
    found = []
    for (nx, ny, nz), (dx, dy, dz), k in zip(
        hits.normal.tolist(), direction.tolist(), hits.material.tolist(), strict=True
    ):
        sine = max(abs(nx * dx + ny * dy + nz * dz), _LEAST_GRAZING)
        mu = MU_SURFACE if k == SURFACE else float(scope.lambert[min(max(k, 0), len(scope.lambert) - 1)])
        found.append(mu * sine * sine)
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
