"""The surface of the sea as a camera sees it, from below and from above: the sky through its small waves, and what they mirror (compiled).

`s` is a row of `formation.SEA` everywhere, x a point about the base of the picture (m), and d the unit direction of a ray, N.
"""

from __future__ import annotations

import math
from typing import Any

from uwserver.environment.light import REFRACTION
from uwserver.frames import Vec3
from uwserver.physics.kernel.deferred import inlined
from uwserver.sensors.optical.camera.caustics import TEXELS, TILE_M
from uwserver.sensors.optical.camera.exponential import exponential

_SUN_WIDTH = 0.06
"""rad; of the sun's image in a ruffled surface."""
_WITHIN = ((-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375))
"""Places in a pixel, parts of it, at which one looks through the surface: the edge of Snell's window is sharp and its waves are small."""
_SHARE = 1.0 / len(_WITHIN)
LEVEL = 0.32
"""Sine of the elevation below which all is mirrored: no wave of `caustics.WAVES` is so steep that light comes in along such a ray."""


@inlined
def waves_at(s: Any, north: float, east: float) -> Vec3:
    """Slopes north and east of the tile of waves, and its curvature (1/m), between its texels."""
    x, y = north * (TEXELS / TILE_M), east * (TEXELS / TILE_M)
    a, b = math.floor(x), math.floor(y)
    p, q = x - a, y - b
    i, j = int(a) & (TEXELS - 1), int(b) & (TEXELS - 1)
    k, m = (i + 1) & (TEXELS - 1), (j + 1) & (TEXELS - 1)
    tile = s.waves
    near, right, below, across = (1.0 - p) * (1.0 - q), (1.0 - p) * q, p * (1.0 - q), p * q
    return (
        near * tile[i, j, 0] + right * tile[i, m, 0] + below * tile[k, j, 0] + across * tile[k, m, 0],
        near * tile[i, j, 1] + right * tile[i, m, 1] + below * tile[k, j, 1] + across * tile[k, m, 1],
        near * tile[i, j, 2] + right * tile[i, m, 2] + below * tile[k, j, 2] + across * tile[k, m, 2],
    )


@inlined
def _reflected(cosine: float, behind: float, ratio: float) -> float:
    """As `environment.light.fresnel`, with the cosine behind the plane."""
    across = (ratio * cosine - behind) / (ratio * cosine + behind)
    along = (cosine - ratio * behind) / (cosine + ratio * behind)
    return 0.5 * (across * across + along * along)


@inlined
def sky_towards(s: Any, x: float, y: float, z: float) -> float:
    """Radiance of the sky towards (x, y, z), in lux/sr of white."""
    cosine = x * s.high[0] + y * s.high[1] + z * s.high[2]
    width = _SUN_WIDTH * _SUN_WIDTH
    glare = 0.0
    if cosine > 0.8:
        glare = (1.0 - s.sky) / (2.0 * math.pi * width) * exponential((cosine - 1.0) / width)
    return float(s.above * (s.sky / math.pi * (1.3 + 0.6 * min(z, 0.0)) + glare))


@inlined
def _window(s: Any, x: float, y: float, z: float, north: float, east: float) -> tuple[float, float]:
    """What a ray that goes up meets in the surface: radiance from above it, and the part of it that mirrors the water."""
    a, b, _ = waves_at(s, north, east)
    # The elevation is up: the normal that points down into the water.
    size = 1.0 / math.sqrt(1.0 + a * a + b * b)
    nx, ny, nz = a * size, b * size, size
    cosine = -(x * nx + y * ny + z * nz)
    square = 1.0 - REFRACTION * REFRACTION * (1.0 - cosine * cosine)
    if cosine <= 0.0 or square <= 0.0:
        return 0.0, 1.0
    behind = math.sqrt(square)
    mirrored, on = _reflected(cosine, behind, REFRACTION), REFRACTION * cosine - behind
    bright = sky_towards(s, REFRACTION * x + on * nx, REFRACTION * y + on * ny, REFRACTION * z + on * nz)
    return (1.0 - mirrored) * REFRACTION * REFRACTION * bright, mirrored


@inlined
def from_below(s: Any, d: Vec3, x: Vec3, r: float) -> Vec3:
    """Radiance of the surface at x, r m away, from the water. What it mirrors is water, as one sees it level just below."""
    dx, dy, dz = d
    above, mirrored = 0.0, 1.0
    if -dz >= LEVEL:
        mirrored = 0.0
        level = math.sqrt(dx * dx + dy * dy)
        ux, uy = (-dy / level, dx / level) if level > 1e-9 else (1.0, 0.0)
        for across, along in _WITHIN:
            p, q = across * s.pixel, along * s.pixel
            # (ux, uy, 0) and its product with the ray are both across it.
            ex, ey, ez = dx + p * ux + q * uy * dz, dy + p * uy - q * ux * dz, dz + q * (ux * dy - uy * dx)
            if ez >= 0.5 * dz:  # nearly level, where all is mirrored
                mirrored += _SHARE
                continue
            far, size = r * dz / ez, 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
            north, east = s.north + x[0] - r * dx + far * ex, s.east + x[1] - r * dy + far * ey
            light, part = _window(s, ex * size, ey * size, ez * size, north, east)
            above, mirrored = above + _SHARE * light, mirrored + _SHARE * part
    return above + mirrored * s.mirrored[0], above + mirrored * s.mirrored[1], above + mirrored * s.mirrored[2]


@inlined
def from_above(s: Any, d: Vec3, x: Vec3) -> Vec3:
    """Radiance of the surface at x from the air: the sky mirrored, and the colour of the water."""
    dx, dy, dz = d
    a, b, _ = waves_at(s, s.north + x[0], s.east + x[1])
    size = 1.0 / math.sqrt(1.0 + a * a + b * b)
    cosine = max((dx * a + dy * b + dz) * size, 0.02)
    ratio = 1.0 / REFRACTION
    mirrored = _reflected(cosine, math.sqrt(1.0 - ratio * ratio * (1.0 - cosine * cosine)), ratio)
    ux, uy, uz = dx - 2.0 * cosine * a * size, dy - 2.0 * cosine * b * size, dz - 2.0 * cosine * size
    bright = mirrored * sky_towards(s, ux, uy, min(uz, -0.01))
    water = 1.0 - mirrored
    return bright + water * s.body[0], bright + water * s.body[1], bright + water * s.body[2]
