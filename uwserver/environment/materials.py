"""What solid things are made of, as sound at sonar frequencies sees it: Lambert's parameter of backscatter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

SEDIMENT_DB = -27.0
"""10 lg mu of Lambert's law S_b = 10 lg mu + 20 lg sin(grazing): K. V. Mackenzie, "Bottom reverberation for 530- and 1030-cps sound in deep
water", J. Acoust. Soc. Am. 33 (1961) 1498; since used for sediment at all sonar frequencies."""

LAMBERT_DB = {
    "sediment": SEDIMENT_DB,
    # guess: orders of magnitude between soft bottoms and hard rough ones; no data sheet tells them
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
"""Of the rough sea surface seen from below (guess: as sand)."""


def lambert(names: Sequence[str]) -> npt.NDArray[np.float64]:
    """(n) linear Lambert parameters of materials in the order of their numbers; an unknown one, as "default", is taken for sediment."""
    return np.array([10.0 ** (0.1 * LAMBERT_DB.get(name, SEDIMENT_DB)) for name in names or ("sediment",)])
