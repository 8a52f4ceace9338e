"""The surface of the sea as a camera sees it, from below and from above: its small waves, the sky through them, and reflections (compiled).

The sea states of a scenario hold no waves shorter than about a metre. But the short waves draw caustics and make Snell's window shiver. So this
module has waves of its own: eight waves of a random sea, 0.25 to 4 m long, that fit a tile, with the dispersion of deep water. The tile repeats.

In all functions `s` is a row of `formation.SEA`, x a point about the base of the picture (m), and d the unit direction of a ray, all in N.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.environment.light import REFRACTION
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import entry, inlined
from uwserver.sensors.optical.camera.exponential import exponential

TILE_M = 4.0
TEXELS = 128
_SLOPE = 0.10
"""Root mean square slope. C. Cox and W. Munk (J. Opt. Soc. Am. 44 (1954) 838) give 0.003 + 0.005 U for its square; this is for a breeze, half of
whose waves are shorter than these."""
_NUMBERS = ((1, 0), (1, 2), (2, -1), (3, 2), (4, -3), (5, 1), (6, 5), (9, -4))
"""Numbers of periods along the two sides of the tile, for each wave."""
_PHASES = (0.3, 4.1, 2.2, 5.7, 1.1, 3.3, 0.9, 2.8)
_SUN_WIDTH = 0.06
"""Width of the sun's image in a ruffled surface, rad."""
_SAMPLES = ((-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375))
"""Points of a pixel, in parts of its size, at which the surface is sampled: the edge of Snell's window is sharp, and its waves are small."""
_SHARE = 1.0 / len(_SAMPLES)
LEVEL = 0.32
"""Sine of the elevation below which everything is mirrored: none of WAVES is so steep that light enters along such a ray."""


def _waves() -> FloatArray:
    """Return (8, 5) amplitude (m), kx, ky (rad/m), omega (rad/s), phase. Each wave has the same share of the slope."""
    k = 2.0 * math.pi / TILE_M * np.array(_NUMBERS, np.float64)
    size = np.linalg.norm(k, axis=1)
    amplitude = _SLOPE * math.sqrt(2.0 / len(k)) / size
    waves: FloatArray = np.column_stack((amplitude, k, np.sqrt(9.81 * size), np.array(_PHASES)))
    return waves


WAVES: FloatArray = _waves()


def fill(t: float, out: Array) -> None:
    """Write the surface at a time (s) into (TEXELS, TEXELS, 3), over north and east: slopes north and east, and the curvature (1/m)."""
    along = np.arange(TEXELS, dtype=np.float64) * (TILE_M / TEXELS)
    north, east = WAVES[:, 1:2] * along, WAVES[:, 2:3] * along + (WAVES[:, 4:5] - WAVES[:, 3:4] * t)
    fill_tile(WAVES, np.stack((np.cos(north), np.sin(north))), np.stack((np.cos(east), np.sin(east))), out)


@entry
def fill_tile(waves: Array, north: Array, east: Array, out: Array) -> None:
    """See `fill`. waves: WAVES; north, east: (2, waves, TEXELS) cosine and sine of the phases along north, and along east and time."""
    for a in range(out.shape[0]):
        for b in range(out.shape[1]):
            x = y = bend = 0.0
            for m in range(len(waves)):
                size, kx, ky = waves[m, 0], waves[m, 1], waves[m, 2]
                s = north[1, m, a] * east[0, m, b] + north[0, m, a] * east[1, m, b]
                c = north[0, m, a] * east[0, m, b] - north[1, m, a] * east[1, m, b]
                x -= size * kx * s
                y -= size * ky * s
                bend -= size * (kx * kx + ky * ky) * c
            out[a, b, 0], out[a, b, 1], out[a, b, 2] = x, y, bend


@inlined
def waves_at(s: Any, north: float, east: float) -> Vec3:
    """Return slopes north and east of the tile of waves and its curvature (1/m), interpolated between texels."""
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
    """Return the reflected part as `environment.light.fresnel` does, with the cosine behind the surface given."""
    across = (ratio * cosine - behind) / (ratio * cosine + behind)
    along = (cosine - ratio * behind) / (cosine + ratio * behind)
    return 0.5 * (across * across + along * along)


@inlined
def sky_towards(s: Any, x: float, y: float, z: float) -> float:
    """Return the radiance of the sky towards (x, y, z), lux/sr of white."""
    cosine = x * s.high[0] + y * s.high[1] + z * s.high[2]
    width = _SUN_WIDTH * _SUN_WIDTH
    glare = 0.0
    if cosine > 0.8:
        glare = (1.0 - s.sky) / (2.0 * math.pi * width) * exponential((cosine - 1.0) / width)
    return float(s.above * (s.sky / math.pi * (1.3 + 0.6 * min(z, 0.0)) + glare))


@inlined
def _window(s: Any, x: float, y: float, z: float, north: float, east: float) -> tuple[float, float]:
    """Return what an upward ray sees in the surface: the radiance from above, and the part that mirrors the water."""
    a, b, _ = waves_at(s, north, east)
    # (nx, ny, nz) is the normal that points down into the water.
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
    """Return the radiance of the surface at x, r m away, seen from the water. It mirrors the water as seen in a level view just below it."""
    dx, dy, dz = d
    above, mirrored = 0.0, 1.0
    if -dz >= LEVEL:
        mirrored = 0.0
        level = math.sqrt(dx * dx + dy * dy)
        ux, uy = (-dy / level, dx / level) if level > 1e-9 else (1.0, 0.0)
        for across, along in _SAMPLES:
            p, q = across * s.pixel, along * s.pixel
            # (ux, uy, 0) and its cross product with the ray are both perpendicular to the ray.
            ex, ey, ez = dx + p * ux + q * uy * dz, dy + p * uy - q * ux * dz, dz + q * (ux * dy - uy * dx)
            if ez >= 0.5 * dz:  # nearly level, where everything is mirrored
                mirrored += _SHARE
                continue
            far, size = r * dz / ez, 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
            north, east = s.north + x[0] - r * dx + far * ex, s.east + x[1] - r * dy + far * ey
            light, part = _window(s, ex * size, ey * size, ez * size, north, east)
            above, mirrored = above + _SHARE * light, mirrored + _SHARE * part
    return above + mirrored * s.mirrored[0], above + mirrored * s.mirrored[1], above + mirrored * s.mirrored[2]


@inlined
def from_above(s: Any, d: Vec3, x: Vec3) -> Vec3:
    """Return the radiance of the surface at x seen from air: the mirrored sky, and the colour of the water."""
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
