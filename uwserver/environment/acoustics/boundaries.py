"""Bottom materials, and losses of sound by reflection at the rough sea surface and at a bottom that is modelled as a fluid."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

SEDIMENT_DB = -27.0
"""10 lg mu of Lambert's law S_b = 10 lg mu + 20 lg sin(grazing): K. V. Mackenzie, "Bottom reverberation for 530- and 1030-cps sound in deep
water", J. Acoust. Soc. Am. 33 (1961) 1498; since used for sediment at all sonar frequencies."""

LAMBERT_DB = {
    "sediment": SEDIMENT_DB,
    # guess: orders of magnitude between soft bottoms and hard rough ones; there are no published values for these materials
    "mud": -35.0,
    "sand": -25.0,
    "gravel": -20.0,
    "rock": -15.0,
    "concrete": -15.0,
    "steel": -10.0,
    "plastic": -20.0,
}
"""10 lg mu by the name of a material."""

SURFACE_DB = -25.0
"""10 lg mu of the rough sea surface seen from below (guess: as for sand)."""
_DB_PER_NEPER = 20.0 / math.log(10.0)
_MOST_DB = 300.0
"""Largest loss that is returned."""


def lambert(names: Sequence[str]) -> npt.NDArray[np.float64]:
    """Return linear Lambert parameters (n) of materials in the order of their numbers; unknown ones, such as "default", count as sediment."""
    return np.array([10.0 ** (0.1 * LAMBERT_DB.get(name, SEDIMENT_DB)) for name in names or ("sediment",)])


class Sediment(NamedTuple):
    """A bottom as a fluid half-space.

    Attributes:
        density_ratio, speed_ratio: density and sound speed over those of the water above.
        attenuation_db: dB per wavelength.
    """

    density_ratio: float
    speed_ratio: float
    attenuation_db: float


SEDIMENTS = {
    # Jensen, Kuperman, Porter, Schmidt, Computational Ocean Acoustics, 2nd ed. 2011, table 1.3: silt, clay, sand, gravel, limestone
    "sediment": Sediment(1.7, 1.05, 1.0),
    "mud": Sediment(1.5, 1.0, 0.2),
    "sand": Sediment(1.9, 1.1, 0.8),
    "gravel": Sediment(2.0, 1.2, 0.6),
    "rock": Sediment(2.4, 2.0, 0.1),
    # guess: 2400 kg/m3 and 3700 m/s, 7850 kg/m3 and 5900 m/s, 1000 kg/m3 and 2300 m/s, for compressional waves in the solids
    "concrete": Sediment(2.4, 2.5, 0.1),
    "steel": Sediment(7.7, 3.9, 0.1),
    "plastic": Sediment(1.0, 1.5, 0.3),
}
"""By the name of the material; shear waves are neglected."""


def sediments(names: Sequence[str]) -> tuple[Sediment, ...]:
    """Return the data of materials in the order of their numbers; unknown ones count as sediment."""
    return tuple(SEDIMENTS.get(name, SEDIMENTS["sediment"]) for name in names or ("sediment",))


class Boundaries(NamedTuple):
    """Surface and bottom, both flat.

    Attributes:
        bottom: depth, m; inf for none.
        sediment: material of the bottom.
        roughness: standard deviation of the surface's elevation, m.
    """

    bottom: float = math.inf
    sediment: Sediment = SEDIMENTS["sediment"]
    roughness: float = 0.0


def surface_loss(grazing: float, roughness: float, wave_number: float) -> float:
    """Return the loss of the coherent reflection at the surface, dB.

    The surface reflects all sound with its sign changed (pressure release). If it is rough, the part exp(-2 (k sigma sin(grazing))^2) of the
    pressure is reflected as by a mirror (Eckart, J. Acoust. Soc. Am. 25 (1953) 566); the scattered rest is neglected.

    Args:
        grazing: angle, rad.
        roughness: standard deviation sigma of the elevation, m.
        wave_number: k, rad/m.
    """
    return min(2.0 * _DB_PER_NEPER * (wave_number * roughness * math.sin(grazing)) ** 2, _MOST_DB)


def bottom_loss(grazing: float, sediment: Sediment) -> float:
    """Return the loss of the reflection at a flat fluid bottom, dB: Rayleigh's coefficient with a complex sound speed (Jensen, Kuperman, Porter,
    Schmidt, Computational Ocean Acoustics, 2nd ed. 2011, section 1.6).

    Args:
        grazing: angle, rad.
        sediment: material of the bottom.
    """
    # An attenuation in dB per wavelength is 20 lg(e) 2 pi times the ratio of imaginary to real part of the wave number.
    index = complex(1.0, sediment.attenuation_db / (2.0 * math.pi * _DB_PER_NEPER)) / sediment.speed_ratio
    below = cmath.sqrt(index * index - math.cos(grazing) ** 2)
    above = sediment.density_ratio * math.sin(grazing)
    size = abs((above - below) / (above + below))
    return min(-20.0 * math.log10(max(size, 1e-15)), _MOST_DB)
