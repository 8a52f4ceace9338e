"""Ports, the windows of camera housings: where a ray that enters the lens comes from in the water.

A ray is followed from the entrance pupil, the origin of S, out of the housing. A flat port bends rays so that they do not meet in one point
(T. Treibitz et al., Flat refractive geometry, IEEE PAMI 34 (2012) 51), so each pixel has an origin as well as a direction. A dome bends nothing
if its centre is the pupil.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.table import Table

WATER_INDEX = 1.34
"""Refractive index of sea water in green light (X. Quan and E. S. Fry, Appl. Opt. 34 (1995) 3477: 1.339 to 1.343 at 35, 10 degC)."""
ACRYLIC_INDEX = 1.49


_Index = Annotated[float, Meta(ge=1, le=3)]


class FlatPort(Table, tag="flat", tag_field="kind", kw_only=True, frozen=True):
    """A plane window across the optical axis. The picture shrinks by a third, and more towards its corners.

    Attributes:
        distance_m: distance of its inner face from the entrance pupil.
        thickness_m, index: thickness and refractive index of the window.
    """

    distance_m: Annotated[float, Meta(ge=0, le=1)] = 0.01
    thickness_m: Annotated[float, Meta(ge=0, le=0.5)] = 0.005
    index: _Index = ACRYLIC_INDEX


class DomePort(Table, tag="dome", tag_field="kind", kw_only=True, frozen=True):
    """A spherical window.

    Attributes:
        radius_m: radius of its outer face.
        thickness_m, index: thickness and refractive index of its wall.
        offset_m: distance of its centre ahead of the entrance pupil. With 0 it bends no light.
    """

    radius_m: Annotated[float, Meta(gt=0, le=1)] = 0.05
    thickness_m: Annotated[float, Meta(ge=0, le=0.2)] = 0.003
    offset_m: Annotated[float, Meta(ge=-1, le=1)] = 0.0
    index: _Index = ACRYLIC_INDEX


Window = FlatPort | DomePort | None


class Bundle(NamedTuple):
    """Rays outside the housing, in S: origins (n, 3), m, and unit directions (n, 3)."""

    origin: FloatArray
    direction: FloatArray


def outside(window: Window, direction: FloatArray, water: float = WATER_INDEX) -> Bundle:
    """Return the rays outside the housing.

    Args:
        window: None if the lens is in the water, or if the camera was calibrated in water.
        direction: (n, 3) unit directions inside the housing.
        water: refractive index of the medium outside; 1 for a camera in air.

    Raises:
        ValueError: a ray does not get through.
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
        at = direction * (window.distance_m / direction[:, :1])
        inside = bent(direction, axis, 1.0 / window.index)
        at = at + inside * (window.thickness_m / inside[:, :1])
        return Bundle(at, bent(inside, axis, window.index / water))
    inner = window.radius_m - window.thickness_m
    if not abs(window.offset_m) < inner:
        raise ValueError("the pupil lies outside the dome: give a smaller offset or thickness")
    centre = np.array((window.offset_m, 0.0, 0.0))
    at, inside = np.zeros_like(direction), direction
    for radius, ratio in ((inner, 1.0 / window.index), (window.radius_m, window.index / water)):
        at = at + inside * _reach(at - centre, inside, radius)
        inside = bent(inside, (at - centre) / radius, ratio)
    return Bundle(at, inside)


def bent(direction: FloatArray, normal: FloatArray, ratio: float) -> FloatArray:
    """Return unit directions (n, 3) after a face (Snell), whose unit normals (n, 3) point in the direction in which rays are followed.

    Args:
        direction, normal: of each ray.
        ratio: refractive index before the face over the index after it.
    """
    along = np.einsum("ij,ij->i", direction, normal)[:, None]
    square = 1.0 - ratio * ratio * (1.0 - along * along)
    if bool((square < 0.0).any()):
        raise ValueError("light is totally reflected in the port: give a smaller field of view or offset")
    out: FloatArray = ratio * direction + (np.sqrt(square) - ratio * along) * normal
    return out


def _reach(start: FloatArray, direction: FloatArray, radius: float) -> FloatArray:
    """Return (n, 1) the distance from points inside a sphere about zero to the sphere, along rays."""
    b = np.einsum("ij,ij->i", start, direction)
    c = np.einsum("ij,ij->i", start, start) - radius * radius
    reach: FloatArray = (-b + np.sqrt(b * b - c))[:, None]
    return reach
