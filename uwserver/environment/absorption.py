"""Absorption of sound in sea water after Francois and Garrison, J. Acoust. Soc. Am. 72 (1982), parts I and II."""

from __future__ import annotations

import math

_DB_PER_M = 1e-3
"""The formulas of the paper use dB/km and kHz."""


def absorption(frequency_Hz: float, temperature: float, salinity: float, depth: float, ph: float = 8.0) -> float:
    """Return the attenuation of a plane wave, dB/m, by boric acid, magnesium sulphate and the water itself.

    The paper states an accuracy of 5 % for 10 to 500 kHz. Above 1 MHz only the water term matters, and the formula is extrapolated.

    Args:
        frequency_Hz: of the sound.
        temperature: degC.
        salinity: practical salinity.
        depth: m, positive down.
        ph: of the water.
    """
    f2 = (frequency_Hz * 1e-3) ** 2
    t, s, d = temperature, salinity, max(0.0, depth)
    kelvin = 273.0 + t
    c = 1412.0 + 3.21 * t + 1.19 * s + 0.0167 * d
    boric = 2.8 * math.sqrt(s / 35.0) * math.pow(10.0, 4.0 - 1245.0 / kelvin)
    sulphate = 8.17 * math.pow(10.0, 8.0 - 1990.0 / kelvin) / (1.0 + 0.0018 * (s - 35.0))
    a1 = 8.86 / c * math.pow(10.0, 0.78 * ph - 5.0)
    a2 = 21.44 * s / c * (1.0 + 0.025 * t) * (1.0 - 1.37e-4 * d + 6.2e-9 * d * d)
    cold = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t * t - 1.50e-8 * t * t * t
    warm = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t * t - 6.5e-10 * t * t * t
    a3 = (cold if t <= 20.0 else warm) * (1.0 - 3.83e-5 * d + 4.9e-10 * d * d)
    relaxing = a1 * boric / (f2 + boric * boric) + a2 * sulphate / (f2 + sulphate * sulphate)
    return (relaxing + a3) * f2 * _DB_PER_M
