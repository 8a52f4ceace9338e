"""Factors from the units of logs to SI. Log numbers are converted with these and nowhere else."""

from __future__ import annotations

import math
from typing import NamedTuple

from uwserver.ports.checks import suggestion
from uwserver.units import rad


class Scale(NamedTuple):
    """A number in the unit, times `factor`, plus `offset`, is the number in SI (angles in rad, temperatures in degC)."""

    factor: float
    offset: float = 0.0


_DEGREE = rad(1.0)
_KNOT = 1852.0 / 3600.0
_G = 9.80665
"""Standard gravity, m/s^2 (CGPM 1901)."""

_LENGTHS = {"km": 1e3, "m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "fathom": 1.8288, "nmi": 1852.0}
_ANGLES = {
    "rad": 1.0, "mrad": 1e-3, "deg": _DEGREE, "cdeg": 1e-2 * _DEGREE, "degE7": 1e-7 * _DEGREE, "degE5": 1e-5 * _DEGREE,
    "deglatitude": _DEGREE, "deglongitude": _DEGREE, "degheading": _DEGREE,
}  # fmt: skip
_SCALES: dict[str, float] = {
    "": 1.0, "1": 1.0, "%": 1e-2, "d%": 1e-3, "c%": 1e-4,
    **_LENGTHS, **_ANGLES,
    **{f"{unit}/s": factor for unit, factor in (_LENGTHS | _ANGLES).items()},
    "km/h": 1 / 3.6, "kn": _KNOT, "knots": _KNOT,
    "m/s^2": 1.0, "m/s/s": 1.0, "cm/s^2": 1e-2, "g": _G, "mG": 1e-3 * _G, "rad/s^2": 1.0, "deg/s^2": _DEGREE,
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0,
    "Pa": 1.0, "hPa": 1e2, "mbar": 1e2, "kPa": 1e3, "dbar": 1e4, "bar": 1e5, "psi": 6894.757293168,
    "degC": 1.0, "cdegC": 1e-2, "degF": 5.0 / 9.0, "K": 1.0,
    "V": 1.0, "mV": 1e-3, "cV": 1e-2, "A": 1.0, "mA": 1e-3, "cA": 1e-2, "W": 1.0, "J": 1.0, "hJ": 1e2,
    "T": 1.0, "uT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "mgauss": 1e-7, "Hz": 1.0, "rpm": 2.0 * math.pi / 60.0, "N": 1.0, "N m": 1.0, "kg": 1.0,
}  # fmt: skip
"""MAVLink writes mG for thousandths of standard gravity, and mgauss for magnetic fields."""
_OFFSETS = {"K": -273.15, "degF": -160.0 / 9.0}


def scale_of(unit: str) -> Scale:
    """Return the conversion of a unit to SI.

    Raises:
        ValueError: the unit is unknown.
    """
    if unit not in _SCALES:
        raise ValueError(f'no unit "{unit}"{suggestion(unit, _SCALES)}')
    return Scale(_SCALES[unit], _OFFSETS.get(unit, 0.0))


def is_known(unit: str) -> bool:
    """Return whether `scale_of` knows the unit."""
    return unit in _SCALES
