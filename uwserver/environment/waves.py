"""Draws the components of a sea of linear waves from a spectrum."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec
import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import (
    WAVE_AMPLITUDE,
    WAVE_DEPTH,
    WAVE_K,
    WAVE_KX,
    WAVE_KY,
    WAVE_OMEGA,
    WAVE_PHASE,
    WAVE_SIZE,
)
from uwserver.table import NonNegative, Positive, Table

BAND = (0.5, 5.0)
"""Lowest and highest frequency of the components over the peak frequency: 0.2 % of the energy of a Pierson-Moskowitz sea lies above."""
_GRID = 4001


class WavesConfig(Table, kw_only=True, frozen=True):
    """A sea of linear (Airy) waves whose elevation is a Gaussian process with the spectrum. Refraction, breaking and currents are neglected.

    Attributes:
        spectrum: "jonswap" (growing sea), or "pierson_moskowitz" (fully grown).
        significant_height_m: Hs, four times the standard deviation of the elevation.
        peak_period_s: Tp.
        direction_deg: direction of travel, clockwise from north.
        spreading: s of the distribution cos^2s(angle / 2) of directions; 0 for waves from all sides. Default: all in one direction.
        peakedness: gamma of JONSWAP.
        components: number of waves, which all have the same energy.
        depth_m: depth of the water, for the dispersion; default: deep water.
    """

    spectrum: Literal["jonswap", "pierson_moskowitz"] = "jonswap"
    significant_height_m: NonNegative
    peak_period_s: Positive
    direction_deg: float = 0.0
    spreading: Annotated[float, msgspec.Meta(ge=0, le=1000)] | msgspec.UnsetType = msgspec.UNSET
    peakedness: Annotated[float, msgspec.Meta(ge=1, le=20)] = 3.3
    components: Annotated[int, msgspec.Meta(ge=1, le=2000)] = 100
    depth_m: Positive | msgspec.UnsetType = msgspec.UNSET


def spectral_shape(config: WavesConfig, omega: float) -> float:
    """Return the spectral density of the elevation at an angular frequency (rad/s), up to a constant factor. Hasselmann et al. 1973."""
    x = omega * config.peak_period_s / (2.0 * math.pi)
    density = x**-5 * math.exp(-1.25 * x**-4)
    if config.spectrum == "jonswap":
        width = 0.07 if x <= 1.0 else 0.09
        density *= config.peakedness ** math.exp(-0.5 * ((x - 1.0) / width) ** 2)
    return density


def wave_number(omega: float, gravity: float, depth: float) -> float:
    """Return k (rad/m) from omega^2 = g k tanh(k h), by Newton's method; h in m, inf for deep water."""
    if math.isinf(depth):
        return omega**2 / gravity
    deep = omega**2 / gravity * depth
    kh = deep / math.sqrt(math.tanh(deep))  # Eckart's approximation, within 5 %
    for _ in range(20):
        tanh = math.tanh(kh)
        kh -= (kh * tanh - deep) / (tanh + kh * (1.0 - tanh**2))
    return kh / depth


def wave_rows(config: WavesConfig, direction: float, gravity: float, rng: np.random.Generator) -> FloatArray:
    """Return components (n, WAVE_SIZE) of equal energy.

    Each frequency is drawn at random from one of n bands of equal energy, and each direction likewise from the spreading. So the variance of the
    elevation is Hs^2 / 16 for any number of components, and the sea does not repeat itself. Functions are taken from `math`, as the last bits of
    numpy's depend on the processor.

    Args:
        config: config of the waves.
        direction: direction of travel, rad from north.
        gravity: m/s2.
        rng: random stream of the waves.
    """
    n = config.components
    peak = 2.0 * math.pi / config.peak_period_s
    grid = peak * np.linspace(*BAND, _GRID)
    omega = _quantiles(grid, [spectral_shape(config, w) for w in grid.tolist()], n, rng)
    angle = np.full(n, direction)
    if config.spreading is not msgspec.UNSET:
        power = 2.0 * float(config.spreading)
        grid = np.linspace(-math.pi, math.pi, _GRID)
        density = [max(0.0, math.cos(0.5 * a)) ** power for a in grid.tolist()]
        angle = angle + rng.permutation(_quantiles(grid, density, n, rng))
    depth = math.inf if config.depth_m is msgspec.UNSET else float(config.depth_m)
    rows = np.zeros((n, WAVE_SIZE))
    for row, w, a in zip(rows, omega.tolist(), angle.tolist(), strict=True):
        k = wave_number(w, gravity, depth)
        row[WAVE_K], row[WAVE_KX], row[WAVE_KY] = k, k * math.cos(a), k * math.sin(a)
    rows[:, WAVE_OMEGA], rows[:, WAVE_DEPTH] = omega, depth
    rows[:, WAVE_AMPLITUDE] = config.significant_height_m / 4.0 * math.sqrt(2.0 / n)
    rows[:, WAVE_PHASE] = rng.uniform(0.0, 2.0 * math.pi, n)
    return rows


def _quantiles(grid: FloatArray, density: list[float], n: int, rng: np.random.Generator) -> FloatArray:
    """Return n random values, one from each of n parts of equal probability of a density on a grid."""
    values = np.array(density)
    cumulated = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(grid))])
    wanted: FloatArray = np.interp((np.arange(n) + rng.random(n)) / n, cumulated / cumulated[-1], grid)
    return wanted
