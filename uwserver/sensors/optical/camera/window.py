"""Ports, the windows of camera housings: where a ray that enters the lens comes from in the water.

A ray is followed from the entrance pupil, the origin of S, out of the housing. Behind a flat port it is bent away, and no two rays meet in one
point (T. Treibitz et al., Flat refractive geometry, IEEE PAMI 34 (2012) 51): so each pixel has an origin beside its direction. A dome changes
nothing where its centre is the pupil.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray

WATER_INDEX = 1.34
"""Of sea water in green light (X. Quan and E. S. Fry, Appl. Opt. 34 (1995) 3477: 1.339 to 1.343 at 35, 10 degC)."""
ACRYLIC_INDEX = 1.49


class FlatPort(NamedTuple):
    """A plane window across the optical axis.

    Attributes:
        distance: of its inner face from the pupil, m.
        thickness: m.
        refraction: index of its material.
    """

    distance: float
    thickness: float = 0.0
    refraction: float = ACRYLIC_INDEX


class DomePort(NamedTuple):
    """A spherical window.

    Attributes:
        radius: of its outer face, m.
        thickness: m.
        offset: of its centre ahead of the pupil, m.
        refraction: index of its material.
    """

    radius: float
    thickness: float = 0.0
    offset: float = 0.0
    refraction: float = ACRYLIC_INDEX


Window = FlatPort | DomePort | None


class Bundle(NamedTuple):
    """Rays in the water, in S: origins (n, 3), m, and unit directions (n, 3)."""

    origin: FloatArray
    direction: FloatArray


def outside(window: Window, direction: FloatArray, water: float = WATER_INDEX) -> Bundle:
    """Rays outside the housing.

    Args:
        window: None where the lens is in the water, as of a camera that was calibrated there.
        direction: (n, 3) unit, behind the window.
        water: index of what is outside; 1 for a camera in air.

    Raises:
        ValueError: a ray does not come through.
    """
    if window is None:
        return Bundle(np.zeros_like(direction), direction.copy())
    if isinstance(window, FlatPort):
        if bool((direction[:, 0] <= 1e-3).any()):
            raise ValueError(
                "a flat port lets nothing in from the side: give a field of view below 175 degrees, or a dome"
            )
        axis = np.zeros_like(direction)
        axis[:, 0] = 1.0
        at = direction * (window.distance / direction[:, :1])
        inside = bent(direction, axis, 1.0 / window.refraction)
        at = at + inside * (window.thickness / inside[:, :1])
        return Bundle(at, bent(inside, axis, window.refraction / water))
    inner = window.radius - window.thickness
    if not abs(window.offset) < inner:
        raise ValueError("the pupil lies outside the dome: give a smaller offset or thickness")
    centre = np.array((window.offset, 0.0, 0.0))
    at, inside = np.zeros_like(direction), direction
    for radius, ratio in ((inner, 1.0 / window.refraction), (window.radius, window.refraction / water)):
        at = at + inside * _reach(at - centre, inside, radius)
        inside = bent(inside, (at - centre) / radius, ratio)
    return Bundle(at, inside)


def bent(direction: FloatArray, normal: FloatArray, ratio: float) -> FloatArray:
    """Unit directions (n, 3) behind a face (Snell), whose unit normals (n, 3) point the way that the light is followed.

    Args:
        direction, normal: of each ray.
        ratio: index before the face over that behind it.
    """
    along = np.einsum("ij,ij->i", direction, normal)[:, None]
    square = 1.0 - ratio * ratio * (1.0 - along * along)
    if bool((square < 0.0).any()):
        raise ValueError("light is totally reflected in the port: give a smaller field of view or offset")
    out: FloatArray = ratio * direction + (np.sqrt(square) - ratio * along) * normal
    return out


def _reach(start: FloatArray, direction: FloatArray, radius: float) -> FloatArray:
    """(n, 1) how far rays from inside a sphere about zero go to it."""
    b = np.einsum("ij,ij->i", start, direction)
    c = np.einsum("ij,ij->i", start, start) - radius * radius
    reach: FloatArray = (-b + np.sqrt(b * b - c))[:, None]
    return reach
