"""Acoustic properties of materials: Lambert's parameter of backscatter, and the data for reflection at a flat bottom."""

from __future__ import annotations

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
