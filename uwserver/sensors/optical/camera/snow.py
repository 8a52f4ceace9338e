"""Marine snow: flakes in the water in front of the camera, lit like the water (compiled).

The flakes fill a cube that repeats through the whole sea and drifts with the current. So they stay in place when the camera moves.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.sensors.optical.camera.lamps import intensity

CUBE_M = 2.0
"""Side of the cube."""
_SINKING_MPS = 0.001
"""100 m a day (A. L. Alldredge and C. Gotschalk, In situ settling behavior of marine snow, Limnol. Oceanogr. 33 (1988) 339: 16 to 368)."""
ALBEDO = 0.35


def flakes(density: float) -> FloatArray:
    """Return (n, 4) positions in the cube, m, and radii, m, for a density per cubic metre. Diameters are 0.5 to 3 mm, mostly small."""
    rng = np.random.Generator(np.random.PCG64(7))
    n = round(min(density, 1e5) * CUBE_M**3)
    places = rng.random((n, 3)) * CUBE_M
    radius = 0.25e-3 * (1.0 - rng.random(n) * (1.0 - 6.0**-2.0)) ** -0.5
    found: FloatArray = np.column_stack((places, radius))
    return found


def drifted(base: tuple[float, float, float], current: tuple[float, float, float], t: float) -> FloatArray:
    """Return the position of the base of a picture in the cube, which has drifted with the current (m/s, N) for t (s)."""
    x = [(p - v * t) % CUBE_M for p, v in zip(base, current, strict=True)]
    x[2] = (x[2] - _SINKING_MPS * t) % CUBE_M
    return np.array(x)


@entry
def add_flakes(
    flakes: Array, base: Array, cube: float, R: Array, lens: Array, width: int, height: int, reach: float, sea: Array, lamps: Array,
    distance: Array, albedo: float, radiance: Array,
) -> int:  # fmt: skip
    """Draw the flakes that are nearer than the things behind them.

    Args:
        flakes: (n, 4), see `flakes`.
        base: (3) base of the picture in the cube, see `drifted`.
        cube: side of the cube, m.
        R: (3, 3) attitude of S in N.
        lens: (4) focal lengths in water and principal point, pixels; accurate enough for specks.
        width, height: size of the picture, pixels.
        reach: distance beyond which flakes are too small, m.
        sea, lamps: see `formation.form`.
        distance: (n) distance of what each pixel sees, m.
        albedo: albedo of a flake.
        radiance: (n, 3), to which each flake is added in proportion to the part of a pixel that it covers.

    Returns:
        The number of flakes that are drawn.
    """
    s, drawn = sea[0], 0
    half = 0.5 * cube
    x = np.empty(3)
    for m in range(len(flakes)):
        far = 0.0
        for i in range(3):
            x[i] = (flakes[m, i] - base[i] + half) % cube - half
            far += x[i] * x[i]
        far = math.sqrt(far)
        ahead = R[0, 0] * x[0] + R[1, 0] * x[1] + R[2, 0] * x[2]
        if far > reach or ahead < 0.03 or x[2] <= s.surface:
            continue
        right = R[0, 1] * x[0] + R[1, 1] * x[1] + R[2, 1] * x[2]
        down = R[0, 2] * x[0] + R[1, 2] * x[1] + R[2, 2] * x[2]
        u, v = lens[0] * right / ahead + lens[2], lens[1] * down / ahead + lens[3]
        size = max(lens[0] * flakes[m, 3] / ahead, 0.35)
        if not (-size <= u <= width - 1 + size and -size <= v <= height - 1 + size):
            continue
        cover = min((lens[0] * flakes[m, 3] / ahead) ** 2 / (size * size), 1.0)
        # Near flakes are out of focus.
        blur = min(0.006 * lens[0] * max(0.12 / ahead - 0.3, 0.0), 8.0)
        cover *= size * size / ((size + blur) * (size + blur))
        _draw(s, lamps, x, far, u, v, size + blur, cover, width, height, distance, albedo, radiance)
        drawn += 1
    return drawn


@compiled
def _draw(
    s: Any, lamps: Array, x: Array, far: float, u: float, v: float, size: float, cover: float, width: int, height: int, distance: Array,
    albedo: float, radiance: Array,
) -> None:  # fmt: skip
    """Draw a flake: a soft disc of radius `size` (pixels) about (u, v)."""
    glow = np.empty(3)
    for i in range(3):
        glow[i] = 0.5 * s.above * s.entered * math.exp(-s.fading[i] * max(x[2] - s.surface, 0.0))
    for lamp in lamps:
        lx, ly, lz = x[0] - lamp.p[0], x[1] - lamp.p[1], x[2] - lamp.p[2]
        away = max(math.sqrt(lx * lx + ly * ly + lz * lz), 0.05)
        lux = intensity(lamp, lx, ly, lz, away) / (away * away)
        for i in range(3):
            glow[i] += lux * math.exp(-s.dimming[i] * away)
    for i in range(3):
        glow[i] *= albedo / math.pi * math.exp(-s.attenuation[i] * far)
    top, bottom = max(int(v - size), 0), min(int(v + size) + 1, height - 1)
    left, right = max(int(u - size), 0), min(int(u + size) + 1, width - 1)
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            off = math.hypot(column - u, row - v)
            share = cover * min(max(size + 0.5 - off, 0.0), 1.0)
            k = row * width + column
            if share > 0.0 and distance[k] > far:
                for i in range(3):
                    radiance[k, i] += share * (glow[i] - radiance[k, i] * 0.5)
