"""From light on a sensor chip to a picture of 8 bits: electrons, noise, counts, white balance and gamma (compiled).

The linear model of EMVA 1288 (release 4.0, 2021): electrons = QE photons, and the number of photons is random. Dark current and read noise are
added, a well holds a limited number of electrons, and an amplifier turns them into counts of 12 bits. Poisson's distribution is replaced by the
normal one of the same mean and variance, also for few electrons.
"""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.sensors.optical.camera.textures import LINEAR, encoded

PHOTONS = 4.1e3
"""Photons of one colour per lux of daylight, square micrometre and second: 1/683 W/lm over the energy of a photon of 555 nm."""
MOST_DN = 4095
"""Largest count of the converter, which has 12 bits."""
TARGET = 0.70
"""Auto-exposure brings the 97th percentile to this part of full scale."""
PERCENTILE = 97.0
_QUANTILES = 1 << 12


class Chip(NamedTuple):
    """A sensor chip behind its lens.

    Attributes:
        pixel_um: side of a pixel, micrometres.
        f_number: f-number of the lens.
        efficiency: QE of red, green and blue, filters and lens included.
        full_well: electrons that a well holds.
        read_noise: electrons.
        dark: dark current, electrons/s.
        gain: DN per electron at 0 dB.
    """

    pixel_um: float
    f_number: float
    efficiency: tuple[float, float, float]
    full_well: float
    read_noise: float
    dark: float
    gain: float

    def electrons(self, exposure: float) -> FloatArray:
        """Return (3) electrons of each colour per lux/sr for an exposure time (s): E = pi L / (4 N^2) on the chip."""
        per = PHOTONS * self.pixel_um**2 * math.pi / (4.0 * self.f_number**2) * exposure
        return per * np.array(self.efficiency)


@cache
def normal_table() -> Any:
    """Return normal deviates of unit variance at evenly spaced quantiles."""
    normal = NormalDist()
    table = np.array([normal.inv_cdf((k + 0.5) / _QUANTILES) for k in range(_QUANTILES)])
    return (table / table.std()).astype(np.float32)


_GAMMA_BITS = 12


@cache
def gamma_table() -> Any:
    """Return (4096) the sRGB value of each count."""
    return encoded((np.arange(1 << _GAMMA_BITS) / float(MOST_DN)).astype(np.float32))


_A, _B, _C = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _16, _32 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(16), np.uint64(32)
_LOW = np.uint64(_QUANTILES - 1)


@compiled
def _bits(seed: Any, k: int) -> Any:
    """Return 64 random bits of a pixel (splitmix64, Steele et al. 2014)."""
    z = seed + np.uint64(k + 1) * _A
    z = (z ^ (z >> _30)) * _B
    z = (z ^ (z >> _27)) * _C
    return z ^ (z >> _31)


@entry
def expose(
    radiance: Array, per: Array, dark: float, full_well: float, read_noise: float, gain: float, seed: Any, normal: Array, counts: Array
) -> None:  # fmt: skip
    """Find the counts (n, 3) of 12 bits.

    Args:
        radiance: (n, 3) lux/sr.
        per: (3) electrons per lux/sr.
        dark: electrons of the dark current during the exposure.
        full_well, read_noise: electrons.
        gain: DN per electron.
        seed: seed of this picture, uint64; 0 for no noise.
        normal: the result of `normal_table`.
        counts: uint16, receives the counts.
    """
    noisy = seed != np.uint64(0)
    for k in range(len(radiance)):
        bits = _bits(seed, k)
        for i in range(3):
            e = max(radiance[k, i] * per[i], 0.0) + dark
            if noisy:
                e += normal[int(bits & _LOW)] * math.sqrt(e + read_noise * read_noise)
                bits >>= _16
            e = min(e, full_well)
            counts[k, i] = int(min(max(e * gain + 0.5, 0.0), 4095.0))


@entry
def expose_mono(
    radiance: Array, per: Array, dark: float, full_well: float, read_noise: float, gain: float, seed: Any, normal: Array, counts: Array
) -> None:  # fmt: skip
    """Do the same as `expose` for a chip without filters: counts (n) of the three colours together."""
    noisy = seed != np.uint64(0)
    for k in range(len(radiance)):
        e = dark
        for i in range(3):
            e += max(radiance[k, i] * per[i], 0.0)
        if noisy:
            e += normal[int(_bits(seed, k) & _LOW)] * math.sqrt(e + read_noise * read_noise)
        e = min(e, full_well)
        counts[k] = int(min(max(e * gain + 0.5, 0.0), 4095.0))


@entry
def develop(counts: Array, table: Array, balance: Array, picture: Array) -> None:
    """Make a picture of 8 bits: white balance, then gamma.

    Args:
        counts: (n, c) counts of 12 bits.
        table: the result of `gamma_table`.
        balance: (c) factors of the colours.
        picture: (n, c) uint8, receives the picture.
    """
    for k in range(len(counts)):
        for i in range(counts.shape[1]):
            picture[k, i] = table[int(min(counts[k, i] * balance[i], 4095.0))]


def metered(picture: Any) -> float:
    """Return the brightness of a picture as a part of full scale: the 97th percentile of the brightest colour, over a sample of pixels."""
    every = max(1, math.isqrt(picture.shape[0] * picture.shape[1] // _METERED))
    some = picture[::every, ::every]
    if some.ndim == 3:
        some = some.max(axis=2)
    return float(LINEAR[np.partition(some.ravel(), k := min(int(0.01 * PERCENTILE * some.size), some.size - 1))[k]])


_METERED = 4096
