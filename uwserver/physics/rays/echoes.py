"""How strongly a surface that sound meets scatters it back (compiled)."""

from __future__ import annotations

from typing import NamedTuple

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.rays.raycast import NOTHING, SURFACE

_LEAST_GRAZING = 0.01
"""Sine of the grazing angle below which backscatter falls no further, as no bottom is perfectly flat."""


class Ground(NamedTuple):
    """How strongly things scatter sound back.

    Attributes:
        lambert: Lambert's parameter by number of the material, linear.
        surface: that of the sea surface.
    """

    lambert: Array
    surface: float


@compiled
def returned(direction: Array, normal: Array, body: int, material: int, ground: Ground) -> float:
    """Return the intensity that a square metre of the surface that a ray hits scatters back to 1 m, per unit of incident intensity: Lambert's law.

    Args:
        direction, normal: (3) of the ray, and of the surface that it hits.
        body, material: those of the surface; a ray without a hit returns 0.
        ground: how strongly materials scatter.
    """
    sine = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    sine = max(abs(sine), _LEAST_GRAZING)
    return float(strength(body, material, ground) * sine * sine)


@compiled
def strength(body: int, material: int, ground: Ground) -> float:
    """Return Lambert's parameter of the surface that a ray hits. An unknown material counts as the last one, as a sensor must not fail."""
    if body == NOTHING:
        return 0.0
    return ground.surface if body == SURFACE else float(ground.lambert[min(max(material, 0), len(ground.lambert) - 1)])
