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


def fill(t: float, out: Array) -> None:
    """The surface at a time (s) into (TEXELS, TEXELS, 3): slopes north and east, and the curvature (1/m), over north and east."""
    along = np.arange(TEXELS, dtype=np.float64) * (TILE_M / TEXELS)
    north, east = WAVES[:, 1:2] * along, WAVES[:, 2:3] * along + (WAVES[:, 4:5] - WAVES[:, 3:4] * t)
    fill_tile(WAVES, np.stack((np.cos(north), np.sin(north))), np.stack((np.cos(east), np.sin(east))), out)


@entry
def fill_tile(waves: Array, north: Array, east: Array, out: Array) -> None:
    """See `fill`; `waves` as `WAVES`, and (2, waves, TEXELS) cosines and sines of the parts of their phases along north, and along east and time."""
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
