"""Losses of sound by reflection at the rough sea surface, and at a bottom that is modelled as a fluid."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

from uwserver.environment.materials import SEDIMENTS, Sediment

_DB_PER_NEPER = 20.0 / math.log(10.0)
_MOST_DB = 300.0
"""Largest loss that is returned."""


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
