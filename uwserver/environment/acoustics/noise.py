"""Ambient noise of the sea by frequency, wind and shipping, and the wind speed that belongs to waves."""

from __future__ import annotations

import math


def ambient_db(frequency_hz: float, wind_mps: float, shipping: float = 0.5) -> float:
    """Return the spectral level of the noise in open water, dB re 1 uPa^2/Hz, from turbulence, distant ships, wind and waves, and thermal noise.

    The formulas are those of Coates (Underwater Acoustic Systems, 1990) for Wenz's curves, as quoted by Stojanovic (ACM Mobile Comp. Commun. Rev. 11
    (2007) 34).

    Args:
        frequency_hz: frequency of the sound.
        wind_mps: speed of the wind.
        shipping: activity of distant ships, 0 to 1.
    """
    f = frequency_hz / 1e3
    decade = math.log10(f)
    levels = (
        17.0 - 30.0 * decade,
        40.0 + 20.0 * (shipping - 0.5) + 26.0 * decade - 60.0 * math.log10(f + 0.03),
        50.0 + 7.5 * math.sqrt(wind_mps) + 20.0 * decade - 40.0 * math.log10(f + 0.4),
        -15.0 + 20.0 * decade,
    )
    return 10.0 * math.log10(math.fsum(10.0 ** (0.1 * level) for level in levels))


def wind_of(roughness: float, gravity: float) -> float:
    """Return the wind speed (m/s at 19.5 m) of a fully developed sea from the standard deviation of its elevation (m): H_s = 0.21 U^2 / g
    (Pierson and Moskowitz, J. Geophys. Res. 69 (1964) 5181)."""
    return math.sqrt(4.0 * roughness * gravity / 0.21)
