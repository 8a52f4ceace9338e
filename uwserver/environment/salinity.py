"""Practical salinity and conductivity of sea water by PSS-78, with its extension to fresh water; for compiled code.

Formulas and coefficients are from Fofonoff and Millard, "Algorithms for computation of fundamental properties of seawater", UNESCO technical papers
in marine science 44 (1983), after papers 36 and 37 of 1981. Below a salinity of 2 they are from Hill, Dauphinee and Woods, "The extension of the
Practical Salinity Scale 1978 to low salinities", IEEE J. Oceanic Eng. 11 (1986), scaled so that both meet at 2, as in GSW (McDougall and Barker
2011, `SP_from_C`).
"""

from __future__ import annotations

import math

from uwserver.physics.kernel.deferred import compiled

STANDARD = 4.29140
"""Conductivity of sea water of salinity 35 at 15 degC (IPTS-68) and zero sea pressure, S/m (Culkin and Smith 1980)."""
_TO_IPTS_68, _K = 1.00024, 0.0162
_A0, _A1, _A2, _A3, _A4, _A5 = 0.0080, -0.1692, 25.3851, 14.0941, -7.0261, 2.7081
_B0, _B1, _B2, _B3, _B4, _B5 = 0.0005, -0.0056, -0.0066, -0.0375, 0.0636, -0.0144
_C0, _C1, _C2, _C3, _C4 = 0.6766097, 2.00564e-2, 1.104259e-4, -6.9698e-7, 1.0031e-9
_D1, _D2, _D3, _D4 = 3.426e-2, 4.464e-4, 4.215e-1, -3.107e-3
_E1, _E2, _E3 = 2.070e-5, -6.370e-10, 3.989e-15
_LOW = 2.0
"""Salinity below which the extension is used."""
_ROOT_OF_LEAST = 0.02
"""Lowest start of Newton's method, on the root of the conductivity ratio. Salinity vanishes at some 0.006, and grows monotonically from here."""
_STEPS, _CLOSE = 20, 1e-9
"""Most steps of Newton's method, and the relative step that is the last one: the next would be below the precision of a double."""


@compiled
def _warmth(t68: float) -> float:
    """Return the temperature factor of salinity at a temperature (degC, IPTS-68)."""
    return (t68 - 15.0) / (1.0 + _K * (t68 - 15.0))


@compiled
def _scale_of_1978(x: float, warmth: float) -> tuple[float, float]:
    """Return the salinity by PSS-78 at the root x of the conductivity ratio, and its derivative with x."""
    salinity = (
        _A0 + x * (_A1 + x * (_A2 + x * (_A3 + x * (_A4 + x * _A5))))
        + warmth * (_B0 + x * (_B1 + x * (_B2 + x * (_B3 + x * (_B4 + x * _B5)))))
    )  # fmt: skip
    slope = (
        _A1 + x * (2.0 * _A2 + x * (3.0 * _A3 + x * (4.0 * _A4 + x * 5.0 * _A5)))
        + warmth * (_B1 + x * (2.0 * _B2 + x * (3.0 * _B3 + x * (4.0 * _B4 + x * 5.0 * _B5))))
    )  # fmt: skip
    return salinity, slope


@compiled
def _fresh(x: float, warmth: float) -> tuple[float, float]:
    """Return the same after Hill et al., before scaling: their correction makes the salinity zero at zero conductivity."""
    salinity, slope = _scale_of_1978(x, warmth)
    y, z = 400.0 * x * x, 10.0 * x
    a, b = 1.0 + y * (1.5 + y), 1.0 + z * (1.0 + z * (1.0 + z))
    salinity -= _A0 / a + _B0 * warmth / b
    slope += _A0 * 800.0 * x * (1.5 + 2.0 * y) / (a * a) + _B0 * warmth * 10.0 * (1.0 + z * (2.0 + 3.0 * z)) / (b * b)
    return salinity, slope


@compiled
def _root_of(salinity: float, warmth: float, fresh: bool) -> float:
    """Return the root of the conductivity ratio at which one of the two scales has a salinity, by Newton's method."""
    x = max(math.sqrt(salinity / 35.0), _ROOT_OF_LEAST)
    for _ in range(_STEPS):
        there, slope = _fresh(x, warmth) if fresh else _scale_of_1978(x, warmth)
        step = (salinity - there) / slope
        x += step
        if abs(step) <= _CLOSE * x:
            break
    return x


@compiled
def _ratio_at_2(warmth: float) -> float:
    """Return the factor that makes the extension equal to PSS-78 at a salinity of 2."""
    there, _ = _fresh(_root_of(_LOW, warmth, False), warmth)
    return float(_LOW / there)


@compiled
def _at_no_pressure(t68: float) -> float:
    """Return the conductivity of water of salinity 35 at a temperature over that at 15 degC, at zero sea pressure."""
    return _C0 + t68 * (_C1 + t68 * (_C2 + t68 * (_C3 + t68 * _C4)))


@compiled
def _pressed(pressure: float) -> float:
    """Return the pressure term of the conductivity ratio."""
    return pressure * (_E1 + pressure * (_E2 + pressure * _E3))


@compiled
def practical_salinity(conductivity: float, temperature: float, sea_pressure: float) -> float:
    """Return practical salinity as `gsw.SP_from_C`, but 0 where the conductivity is below that of fresh water or is impossible for water.

    The scale is valid for 2 to 42, -2 to 35 degC and 0 to 10 000 dbar, its extension below 2.

    Args:
        conductivity: S/m.
        temperature: in situ, degC, ITS-90.
        sea_pressure: dbar, without that of the atmosphere.
    """
    t68 = temperature * _TO_IPTS_68
    warmth, ratio = _warmth(t68), conductivity / STANDARD
    pressed = 1.0 + _pressed(sea_pressure) / (1.0 + t68 * (_D1 + t68 * _D2) + (_D3 + _D4 * t68) * ratio)
    scale = pressed * _at_no_pressure(t68)
    if not ratio * scale > 0.0:
        return 0.0
    x = math.sqrt(ratio / scale)
    salinity, _ = _scale_of_1978(x, warmth)
    if salinity < _LOW:
        salinity, _ = _fresh(x, warmth)
        salinity *= _ratio_at_2(warmth)
    return float(max(0.0, salinity))


@compiled
def conductivity_of(salinity: float, temperature: float, sea_pressure: float) -> float:
    """Return the conductivity (S/m) of a practical salinity (0 or more), as `gsw.C_from_SP`: the inverse of `practical_salinity` up to rounding.

    Args:
        salinity: practical.
        temperature: in situ, degC, ITS-90.
        sea_pressure: dbar, without that of the atmosphere.
    """
    t68 = temperature * _TO_IPTS_68
    warmth = _warmth(t68)
    fresh = salinity < _LOW
    x = _root_of(salinity / _ratio_at_2(warmth) if fresh else salinity, warmth, fresh)
    # The effect of pressure depends on the ratio itself, so the ratio r solves a quadratic equation: a r^2 + b r = c.
    unpressed = x * x * _at_no_pressure(t68)
    a, free = _D3 + _D4 * t68, 1.0 + t68 * (_D1 + t68 * _D2)
    b, c = free - a * unpressed, unpressed * (free + _pressed(sea_pressure))
    return float(STANDARD * 2.0 * c / (b + math.sqrt(b * b + 4.0 * a * c)))
