"""Linear waves from a seeded spectrum: which components make up the sea."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec
import numpy as np
import numpy.typing as npt

from uwserver.physics.layout import (
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

FloatArray = npt.NDArray[np.float64]

BAND = (0.5, 5.0)
"""Frequencies of the components, in peak frequencies: 0.2 % of the energy of a Pierson-Moskowitz sea lies above."""


class WavesConfig(Table, kw_only=True, frozen=True):
    """A sea of linear (Airy) waves; its elevation is a Gaussian process of the spectrum. Refraction, breaking and currents do not act on it.

    Attributes:
        spectrum: "jonswap" (growing sea), or "pierson_moskowitz" (fully grown).
        significant_height_m: Hs, four times the standard deviation of the elevation.
        peak_period_s: Tp.
        direction_deg: where the waves go to, clockwise from north.
        spreading: s of the distribution cos^2s(angle / 2) of directions; 0 is from everywhere. Default: all in one direction.
        peakedness: gamma of JONSWAP.
        components: how many waves; each has the same part of the energy.
        depth_m: of the water, for the dispersion; default: deep water.
    """

    spectrum: Literal["jonswap", "pierson_moskowitz"] = "jonswap"
    significant_height_m: NonNegative
    peak_period_s: Positive
    direction_deg: float = 0.0
    spreading: Annotated[float, msgspec.Meta(ge=0, le=1000)] | msgspec.UnsetType = msgspec.UNSET
    peakedness: Annotated[float, msgspec.Meta(ge=1, le=20)] = 3.3
    components: Annotated[int, msgspec.Meta(ge=1, le=2000)] = 100
    depth_m: Positive | msgspec.UnsetType = msgspec.UNSET


def spectral_shape(config: WavesConfig, omega: FloatArray) -> FloatArray:
    """Density of the elevation's variance at angular frequencies (rad/s), up to a factor. Hasselmann et al. 1973."""
    x = omega * config.peak_period_s / (2.0 * math.pi)
    density: FloatArray = x**-5 * np.exp(-1.25 * x**-4)
    if config.spectrum == "jonswap":
        width = np.where(x <= 1.0, 0.07, 0.09)
        density = density * config.peakedness ** np.exp(-0.5 * ((x - 1.0) / width) ** 2)
    return density


def wave_number(omega: FloatArray, gravity: float, depth: float) -> FloatArray:
    """k (rad/m) of omega^2 = g k tanh(k h), by Newton's rule; h in m, inf for deep water."""
    if math.isinf(depth):
        return omega**2 / gravity
    deep = omega**2 / gravity * depth
    kh = deep / np.sqrt(np.tanh(deep))  # Eckart's, within 5 %
    for _ in range(20):
        tanh = np.tanh(kh)
        kh = kh - (kh * tanh - deep) / (tanh + kh * (1.0 - tanh**2))
    return kh / depth


def wave_rows(config: WavesConfig, direction: float, gravity: float, rng: np.random.Generator) -> FloatArray:
    """Components (n, WAVE_SIZE) of equal energy.

    Frequencies lie at random within the bands that share the energy equally, directions likewise in the spreading: so the variance of the
    elevation is Hs^2 / 16 for any number of components, and the sea does not repeat itself.

    Args:
        config: of the waves.
        direction: where they go to, rad from north.
        gravity: m/s2.
        rng: stream of the waves.
    """
    n = config.components
    peak = 2.0 * math.pi / config.peak_period_s
    grid = peak * np.linspace(*BAND, 20_001)
    omega = _quantiles(grid, spectral_shape(config, grid), n, rng)
    angle = np.full(n, direction)
    if config.spreading is not msgspec.UNSET:
        grid = np.linspace(-math.pi, math.pi, 20_001)
        density = np.maximum(np.cos(0.5 * grid), 0.0) ** (2.0 * float(config.spreading))
        angle = angle + rng.permutation(_quantiles(grid, density, n, rng))
    depth = math.inf if config.depth_m is msgspec.UNSET else float(config.depth_m)
    rows = np.zeros((n, WAVE_SIZE))
    k = wave_number(omega, gravity, depth)
    rows[:, WAVE_K], rows[:, WAVE_KX], rows[:, WAVE_KY] = k, k * np.cos(angle), k * np.sin(angle)
    rows[:, WAVE_OMEGA], rows[:, WAVE_DEPTH] = omega, depth
    rows[:, WAVE_AMPLITUDE] = config.significant_height_m / 4.0 * math.sqrt(2.0 / n)
    rows[:, WAVE_PHASE] = rng.uniform(0.0, 2.0 * math.pi, n)
    return rows


def _quantiles(grid: FloatArray, density: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """One random value from each of n parts of equal probability of a density on a grid."""
    cumulated = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(grid))])
    wanted: FloatArray = np.interp((np.arange(n) + rng.random(n)) / n, cumulated / cumulated[-1], grid)
    return wanted
