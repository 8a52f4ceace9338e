"""Lamps in the water: their light, and the veil of light that the water scatters back (compiled)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.environment.light import ASYMMETRY, WaterLight
from uwserver.frames import Quat, Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.sensors.optical.camera.exponential import exponential

LAMP = np.dtype(
    [
        ("p", "f8", (3,)),  # about the base of the picture, N, m
        ("axis", "f8", (3,)),  # unit, N
        ("candela", "f8"),  # intensity on the axis
        ("exponent", "f8"),  # power of the cosine with which the intensity falls off the axis
        ("row", "i4"),  # row of the body that carries it
    ]
)
"""A lamp in a picture."""

COARSE = 16
"""Pixels along the side of a cell of the veil."""
STEPS = 20
_FIRST, _LAST = 0.05, 25.0
"""m. The ranges of the veil grow by a constant factor."""
RANGES: FloatArray = _FIRST * (_LAST / _FIRST) ** (np.arange(STEPS) / (STEPS - 1.0))
_NEAREST = 0.03
"""m from a lamp. Nearer water counts as if it were at this distance."""


class LampAt(NamedTuple):
    """A lamp on a body.

    Attributes:
        row: row of the body.
        p, q: pose of the lamp on the body; it shines along its x axis.
        cone: full angle between the directions of half the intensity, rad.
        lumens: present luminous flux.
    """

    row: int
    p: Vec3
    q: Quat
    cone: float
    lumens: float


def exponent_of(cone: float) -> float:
    """Return the power of the cosine that has half its value at the edge of a cone (rad)."""
    return math.log(0.5) / math.log(max(math.cos(0.5 * cone), 1e-6))


def candelas(lumens: float, exponent: float) -> float:
    """Return the intensity on the axis of a lamp, if the intensity is a power of the cosine over the half space."""
    return lumens * (exponent + 1.0) / (2.0 * math.pi)


@compiled
def intensity(lamp: Any, x: float, y: float, z: float, far: float) -> float:
    """Return the intensity (cd) towards a point at (x, y, z) from the lamp, at the distance `far` (m)."""
    along = (lamp.axis[0] * x + lamp.axis[1] * y + lamp.axis[2] * z) / far
    if along <= 0.0:
        return 0.0
    return float(lamp.candela * exponential(lamp.exponent * math.log(along)))


@entry
def fill_veil(
    lamps: Array, origin: Array, direction: Array, width: int, coarse: int, ranges: Array, dimming: Array, attenuation: Array, scattering: Array,
    asymmetry: float, nearest: float, veil: Array,
) -> None:  # fmt: skip
    """Find the light of lamps that the water scatters back from before each range.

    Args:
        lamps: LAMP (n).
        origin, direction: (n, 3) rays of the whole picture.
        width: width of the picture, pixels.
        coarse: pixels along the side of a cell of the veil.
        ranges: (s) ranges, m.
        dimming: (3) attenuation of lamplight on its way out, 1/m.
        attenuation, scattering: (3) coefficients of the water, 1/m.
        asymmetry: asymmetry of Henyey and Greenstein's phase function.
        nearest: smallest distance from a lamp, m.
        veil: (rows, columns, s, 3) receives the veil at the corners of the cells, lux/sr.
    """
    g, gg = asymmetry, asymmetry * asymmetry
    height = len(direction) // width
    for row in range(veil.shape[0]):
        for column in range(veil.shape[1]):
            k = min(row * coarse, height - 1) * width + min(column * coarse, width - 1)
            sums = np.zeros(3)
            before = 0.0
            for s in range(len(ranges)):
                middle, step = 0.5 * (before + ranges[s]), ranges[s] - before
                before = ranges[s]
                px, py, pz = (
                    origin[k, 0] + middle * direction[k, 0],
                    origin[k, 1] + middle * direction[k, 1],
                    origin[k, 2] + middle * direction[k, 2],
                )
                for lamp in lamps:
                    x, y, z = px - lamp.p[0], py - lamp.p[1], pz - lamp.p[2]
                    far = max(math.sqrt(x * x + y * y + z * z), nearest)
                    light = intensity(lamp, x, y, z, far) / (far * far)
                    if light <= 0.0:
                        continue
                    # Light travels along (x, y, z) and is scattered back against the ray.
                    turn = -(x * direction[k, 0] + y * direction[k, 1] + z * direction[k, 2]) / far
                    spread = 1.0 + gg - 2.0 * g * turn
                    phase = (1.0 - gg) / (4.0 * math.pi * spread * math.sqrt(spread))
                    for i in range(3):
                        sums[i] += (
                            light
                            * phase
                            * scattering[i]
                            * step
                            * exponential(-attenuation[i] * middle - dimming[i] * far)
                        )
                for i in range(3):
                    veil[row, column, s, i] = sums[i]


def veil_of(lamps: Any, rays: tuple[Any, Any], width: int, water: WaterLight) -> FloatArray:
    """Return the veil of a picture: (rows, columns, STEPS, 3), see `fill_veil`; empty without lamps."""
    if not len(lamps):
        return np.zeros((0, 0, STEPS, 3))
    origin, direction = rays
    height = len(direction) // width
    veil: FloatArray = np.empty((-(-height // COARSE) + 1, -(-width // COARSE) + 1, STEPS, 3))
    dimming, attenuation, scattering = (
        np.array(colours) for colours in (water.dimming(), water.attenuation, water.scattering)
    )
    fill_veil(
        lamps, origin, direction, width, COARSE, RANGES, dimming, attenuation, scattering, ASYMMETRY, _NEAREST, veil
    )
    return veil


SHADOW = 2
"""Pixels along the side of a cell of shadows. Each cell casts one ray to a lamp."""


@entry
def light_rays(
    lamp: Array, origin: Array, direction: Array, distance: Array, width: int, cell: int, least: float, attenuation: float, points: Array,
    towards: Array, reach: Array,
) -> None:  # fmt: skip
    """Make the rays for shadows: from what one pixel of each cell sees to a lamp.

    Args:
        lamp: LAMP (1).
        origin, direction, distance: the rays of the picture, and what they hit.
        width: width of the picture, pixels.
        cell: pixels along the side of a cell.
        least: illuminance below which no ray is cast, lux.
        attenuation: attenuation of the least attenuated colour, 1/m.
        points, towards: (cells, 3) receive starts and directions, row after row.
        reach: (cells) receives the distance of the lamp, m; 0 for no ray.
    """
    columns = (width + cell - 1) // cell
    for m in range(len(reach)):
        reach[m] = 0.0
        k = (m // columns) * cell * width + (m % columns) * cell
        r = distance[k]
        if r > 1e6:
            continue
        # Start a little before the surface, so that the ray does not hit the surface itself.
        r -= 1e-3 + 1e-4 * r
        for i in range(3):
            points[m, i] = origin[k, i] + r * direction[k, i]
        x, y, z = points[m, 0] - lamp[0].p[0], points[m, 1] - lamp[0].p[1], points[m, 2] - lamp[0].p[2]
        far = math.sqrt(x * x + y * y + z * z)
        if far < 0.01:
            continue
        lux = intensity(lamp[0], x, y, z, far) / (far * far) * math.exp(-attenuation * far)
        if lux < least:
            continue
        towards[m, 0], towards[m, 1], towards[m, 2] = -x / far, -y / far, -z / far
        reach[m] = far
