"""What comes back of the sound that meets something (compiled)."""

from __future__ import annotations

from typing import NamedTuple

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
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


@entry
def backscatter(
    direction: Array, normal: Array, bodies: Array, material: Array, lambert: Array, surface: float, out: Array
) -> None:
    """Intensity that a square metre of what each ray hits scatters back at 1 m, per unit of incident intensity: Lambert's law.

    Args:
        direction, normal: (n, 3) of the rays and of what they hit.
        bodies, material: (n) of what they hit; nothing comes back from a miss.
        lambert, surface: of `Ground`.
        out: (n) receives it.
    """
    ground = Ground(lambert, surface)
    for i in range(len(out)):
        out[i] = returned(direction[i], normal[i], bodies[i], material[i], ground)


@compiled
def returned(direction: Array, normal: Array, body: int, material: int, ground: Ground) -> float:
    """The same of one ray."""
    sine = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    sine = max(abs(sine), _LEAST_GRAZING)
    return float(strength(body, material, ground) * sine * sine)


@compiled
def strength(body: int, material: int, ground: Ground) -> float:
    """Lambert's parameter of what a ray hits. A material that nobody named counts as the last one: a sensor is no place to fail."""
    if body == NOTHING:
        return 0.0
    return ground.surface if body == SURFACE else float(ground.lambert[min(max(material, 0), len(ground.lambert) - 1)])
