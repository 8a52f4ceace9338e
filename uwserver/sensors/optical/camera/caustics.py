"""What small waves do to light: a tile of the surface that repeats, with its slopes and with how it gathers sunlight below (compiled).

The sea states of a scenario hold no waves shorter than about a metre, and it is the short ones that draw caustics and make Snell's window shiver.
So these are waves of their own: eight of a random sea, of a quarter to four metres, that fit the tile, by the dispersion of deep water.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import entry

TILE_M = 4.0
TEXELS = 128
_SLOPE = 0.10
"""Root mean square slope: C. Cox and W. Munk (J. Opt. Soc. Am. 44 (1954) 838) have 0.003 + 0.005 U for its square; a breeze, and half of its
waves are shorter than these."""
_NUMBERS = ((1, 0), (1, 2), (2, -1), (3, 2), (4, -3), (5, 1), (6, 5), (9, -4))
"""Waves along both sides of the tile."""
_PHASES = (0.3, 4.1, 2.2, 5.7, 1.1, 3.3, 0.9, 2.8)


def _waves() -> FloatArray:
    """(8, 5) amplitude (m), kx, ky (rad/m), omega (rad/s), phase: each wave has the same share of the slope."""
    k = 2.0 * math.pi / TILE_M * np.array(_NUMBERS, np.float64)
    size = np.linalg.norm(k, axis=1)
    amplitude = _SLOPE * math.sqrt(2.0 / len(k)) / size
    waves: FloatArray = np.column_stack((amplitude, k, np.sqrt(9.81 * size), np.array(_PHASES)))
    return waves


WAVES: FloatArray = _waves()


def tile(t: float) -> FloatArray:
    """(TEXELS, TEXELS, 3) of the surface at a time (s): slopes north and east, and the curvature (1/m), over north and east."""
    out: FloatArray = np.empty((TEXELS, TEXELS, 3))
    fill_tile(WAVES, t, TILE_M / TEXELS, out)
    return out


@entry
def fill_tile(waves: Array, t: float, step: float, out: Array) -> None:
    """See `tile`; `waves` as `WAVES`, `step` (m) between texels."""
    for a in range(out.shape[0]):
        for b in range(out.shape[1]):
            north = east = bend = 0.0
            for m in range(len(waves)):
                size, kx, ky = waves[m, 0], waves[m, 1], waves[m, 2]
                phase = kx * a * step + ky * b * step - waves[m, 3] * t + waves[m, 4]
                s, c = math.sin(phase), math.cos(phase)
                north -= size * kx * s
                east -= size * ky * s
                bend -= size * (kx * kx + ky * ky) * c
            out[a, b, 0], out[a, b, 1], out[a, b, 2] = north, east, bend
