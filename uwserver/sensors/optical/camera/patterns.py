"""The patterns of things without a texture: sand on the seabed and growth on structures, as noise of a few octaves, and pool tiles (compiled).

Octaves finer than two pixels are left out, so that distant things do not flicker.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.environment.light import Colours
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, inlined
from uwserver.sensors.optical.camera.textures import LINEAR

_COUNT = 4096
_TABLE: Any = np.random.Generator(np.random.PCG64(20)).random(_COUNT).astype(np.float32)
_MASK = _COUNT - 1
_LIGHT: FloatArray = LINEAR.astype(np.float64)


@compiled
def _lattice(x: int, y: int, z: int) -> float:
    h = x * 73856093 ^ y * 19349663 ^ z * 83492791
    h ^= h >> 13
    return float(_TABLE[(h * 1274126177 >> 7) & _MASK])


@compiled
def flat_noise(x: float, y: float) -> float:
    """Return value noise in a plane, 0 to 1, on a lattice of step one."""
    a, b = math.floor(x), math.floor(y)
    u, v, i, j = x - a, y - b, int(a), int(b)
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    low = _lattice(i, j, 0) * (1.0 - u) + _lattice(i + 1, j, 0) * u
    high = _lattice(i, j + 1, 0) * (1.0 - u) + _lattice(i + 1, j + 1, 0) * u
    return float(low * (1.0 - v) + high * v)


@compiled
def noise(x: float, y: float, z: float) -> float:
    """Return value noise in space, 0 to 1, on a lattice of step one."""
    a, b, c = math.floor(x), math.floor(y), math.floor(z)
    u, v, w, i, j, k = x - a, y - b, z - c, int(a), int(b), int(c)
    u, v, w = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v), w * w * (3.0 - 2.0 * w)
    near = (_lattice(i, j, k) * (1.0 - u) + _lattice(i + 1, j, k) * u) * (1.0 - v) + (
        _lattice(i, j + 1, k) * (1.0 - u) + _lattice(i + 1, j + 1, k) * u
    ) * v
    k += 1
    far = (_lattice(i, j, k) * (1.0 - u) + _lattice(i + 1, j, k) * u) * (1.0 - v) + (
        _lattice(i, j + 1, k) * (1.0 - u) + _lattice(i + 1, j + 1, k) * u
    ) * v
    return float(near * (1.0 - w) + far * w)


@compiled
def _share(length: float, pixel: float) -> float:
    """Return how much of an octave of this length (m) a pixel (m) still shows, 0 to 1."""
    return min(max(0.5 * length / pixel - 0.5, 0.0), 1.0)


@inlined
def seabed(x: float, y: float, pixel: float, colour: Colours) -> Colours:
    """Return sand of a colour: patches of metres, ripples of decimetres, grains and shells of centimetres."""
    tone = 0.35 * (flat_noise(0.31 * x, 0.31 * y) - 0.5)
    share = _share(0.45, pixel)
    if share > 0.0:
        bend = 2.2 * flat_noise(0.6 * x + 7.0, 0.6 * y)
        tone += 0.16 * share * math.sin(2.0 * math.pi * (x * 2.1 + 0.5 * y + bend)) * flat_noise(0.2 * x, 0.2 * y + 3.0)
    share = _share(0.11, pixel)
    if share > 0.0:
        tone += 0.32 * share * (flat_noise(9.1 * x, 9.1 * y) - 0.5)
    share = _share(0.022, pixel)
    if share > 0.0:
        grain = flat_noise(46.0 * x, 46.0 * y)
        tone += 0.4 * share * (grain - 0.5)
        if grain > 0.93:  # a bit of shell
            tone += 0.5 * share
    tone += 1.0
    return (
        min(max(colour[0] * tone, 0.0), 1.0),
        min(max(colour[1] * tone, 0.0), 1.0),
        min(max(colour[2] * tone, 0.0), 1.0),
    )


@inlined
def grown(x: float, y: float, z: float, up: float, pixel: float, colour: Colours) -> Colours:
    """Return a colour covered by algae and rust, with more of them on faces that point up. up: cosine of the angle of the face from up."""
    coat = noise(1.3 * x, 1.3 * y, 1.3 * z)
    share = _share(0.14, pixel)
    fine = 0.5
    if share > 0.0:
        fine += share * (noise(7.0 * x, 7.0 * y, 7.0 * z) - 0.5)
    coat = min(max(2.2 * (coat + 0.35 * (fine - 0.5) - 0.5) + 0.2 * up + 0.3, 0.0), 0.85)
    share = _share(0.03, pixel)
    tone = 0.75 + 0.5 * fine
    if share > 0.0:
        tone += 0.4 * share * (noise(33.0 * x, 33.0 * y, 33.0 * z) - 0.5)
    bare = 1.0 - coat
    return (
        tone * (bare * colour[0] + coat * 0.14),
        tone * (bare * colour[1] + coat * 0.15),
        tone * (bare * colour[2] + coat * 0.06),
    )


_TILE_M, _GROUT_M = 0.25, 0.01
"""The same as on the page of the web view."""


@compiled
def _grout(x: float, pixel: float) -> float:
    """Return how much of a pixel at x lies on lines of grout across x, 0 to 1."""
    cell = x / _TILE_M
    line = _TILE_M * min(cell - math.floor(cell), math.floor(cell) + 1.0 - cell)
    covered = min(max((0.5 * (_GROUT_M + pixel) - line) / max(min(pixel, _GROUT_M), 1e-6), 0.0), 1.0)
    return covered * min(_GROUT_M / pixel, 1.0) if pixel > 0.0 else covered


@inlined
def tiles(place: Vec3, normal: Vec3, pixel: float, colour: Colours) -> Colours:
    """Return the colour of tiles of 0.25 m with grout between them, slightly different from each other. `normal` gives the plane of the tiles."""
    share = _share(4.0 * _TILE_M, pixel)
    if share <= 0.0:
        return colour
    a, b, c = abs(normal[0]), abs(normal[1]), abs(normal[2])
    u, v = place[1], place[2]  # coordinates across the axis nearest to the normal
    if c >= a and c >= b:
        u, v = place[0], place[1]
    elif b >= a:
        u, v = place[0], place[2]
    dark = max(_grout(u, pixel), _grout(v, pixel))
    m, n = math.floor(u / _TILE_M), math.floor(v / _TILE_M)
    tone = 0.08 * (_lattice(int(m), int(n), 5) - 0.5)
    tone = 1.0 + share * ((1.0 - dark) * tone - 0.4 * dark)
    return colour[0] * tone, colour[1] * tone, colour[2] * tone


@compiled
def sampled(texels: Array, levels: Array, texture: int, u: float, v: float, blur: float, colour: Colours) -> Colours:
    """Return a colour times a texture, which repeats.

    Args:
        texels, levels: the atlas.
        texture: number of the finest level of the texture.
        u, v: texture coordinates, 0 to 1 from the upper left.
        blur: texels of the finest level that a pixel covers.
        colour: colour of the face.
    """
    coarser = 0
    while blur > 1.4 and coarser < levels[texture].levels:
        blur *= 0.5
        coarser += 1
    level = levels[texture + coarser]
    w, h = level.width, level.height
    x, y = (u - math.floor(u)) * w - 0.5, (v - math.floor(v)) * h - 0.5
    a, b = math.floor(x), math.floor(y)
    p, q = x - a, y - b
    i, j = int(a) % w, int(b) % h
    right, below = (i + 1) % w, (j + 1) % h
    upper, lower = level.first + j * w, level.first + below * w
    return (
        colour[0] * _texel(texels, 0, (upper + i, upper + right, lower + i, lower + right), p, q),
        colour[1] * _texel(texels, 1, (upper + i, upper + right, lower + i, lower + right), p, q),
        colour[2] * _texel(texels, 2, (upper + i, upper + right, lower + i, lower + right), p, q),
    )


@inlined
def _texel(texels: Array, c: int, four: tuple[int, int, int, int], p: float, q: float) -> float:
    """Return the light of one colour, interpolated between four texels, upper left to lower right."""
    top = _LIGHT[texels[four[0], c]] * (1.0 - p) + _LIGHT[texels[four[1], c]] * p
    low = _LIGHT[texels[four[2], c]] * (1.0 - p) + _LIGHT[texels[four[3], c]] * p
    return float(top * (1.0 - q) + low * q)
