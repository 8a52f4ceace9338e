"""What comes back of the sound that meets something (compiled)."""

from __future__ import annotations

from typing import NamedTuple

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.rays.raycast import NOTHING, SURFACE

_LEAST_GRAZING = 0.01
"""Sine below which backscatter falls no further: no bottom is that flat."""


class Ground(NamedTuple):
    """How strongly things scatter sound back.

    Attributes:
        lambert: Lambert's parameter by material, linear.
        surface: of the sea surface.
    """

    lambert: Array
    surface: float


@compiled
def returned(direction: Array, normal: Array, body: int, material: int, ground: Ground) -> float:
    """Intensity that a square metre of what a ray hits scatters back at 1 m, per unit of incident intensity: Lambert's law.

    Args:
        direction, normal: (3) of the ray and of what it hits.
        body, material: of what it hits; nothing comes back from a miss.
        ground: how strongly that scatters.
    """
    sine = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    sine = max(abs(sine), _LEAST_GRAZING)
    return float(strength(body, material, ground) * sine * sine)


@compiled
def strength(body: int, material: int, ground: Ground) -> float:
    """Lambert's parameter of what a ray hits. A material that nobody named counts as the last one: a sensor is no place to fail."""
    if body == NOTHING:
        return 0.0
    return ground.surface if body == SURFACE else float(ground.lambert[min(max(material, 0), len(ground.lambert) - 1)])
