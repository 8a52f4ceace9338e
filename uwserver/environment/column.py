"""The water column: temperature, salinity, density, pressure and sound speed over depth by TEOS-10, tabulated before the first tick; and the
absorption of sound."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Literal

import gsw
import numpy as np
from msgspec import Meta

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.table import Positive, Table

_DB_PER_M = 1e-3
"""The formulas of the paper use dB/km and kHz."""
_DECIBAR = 1e4
_GRID = np.concatenate([np.arange(0.0, 300.0, 0.5), np.arange(300.0, 2000.0, 5.0), np.arange(2000.0, 12_001.0, 25.0)])
"""Depths of the tables, m; the depths where a profile bends are added. The error of linear interpolation is less than 0.002 m/s of sound speed."""
DEPTH, TEMPERATURE, SALINITY, DENSITY, SOUND_SPEED, PRESSURE = range(6)
"""Columns of `WaterColumn.table`."""


def absorption(frequency_Hz: float, temperature: float, salinity: float, depth: float, ph: float = 8.0) -> float:
    """Return the attenuation of a plane wave, dB/m, by boric acid, magnesium sulphate and the water itself.

    The paper states an accuracy of 5 % for 10 to 500 kHz. Above 1 MHz only the water term matters, and the formula is extrapolated.

    Args:
        frequency_Hz: frequency of the sound.
        temperature: degC.
        salinity: practical salinity.
        depth: m, positive down.
        ph: pH of the water.
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


Temperature = Annotated[float, Meta(ge=-2, le=40)]
Salinity = Annotated[float, Meta(ge=0, le=42)]


class ColumnTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """Keys of every kind of water column.

    Attributes:
        hydrostatics: "teos10" integrates the density of the column; "uniform" uses p = rho g h with `density_kgpm3` of the environment. Both use
            the gravity of the environment.
        ph: acidity, which affects the absorption of sound below 10 kHz.
    """

    hydrostatics: Literal["teos10", "uniform"] = "teos10"
    ph: Annotated[float, Meta(ge=6.5, le=9)] = 8.0


class ConstantColumn(ColumnTable, tag="constant", kw_only=True, frozen=True):
    """The same temperature (in situ) and practical salinity at all depths."""

    temperature_degc: Temperature = 10.0
    salinity_psu: Salinity = 35.0

    def bends(self) -> FloatArray:
        """Return depths (m) at which the tables need additional points."""
        return np.zeros(0)

    def water_at(self, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return temperature (degC) and practical salinity at depths (m)."""
        return np.full(depth.shape, self.temperature_degc), np.full(depth.shape, self.salinity_psu)


class ThermoclineColumn(ColumnTable, tag="thermocline", kw_only=True, frozen=True):
    """Two layers with a smooth step between them: a tanh about `depth_m`, with most of the change within `thickness_m`."""

    surface_temperature_degc: Temperature
    deep_temperature_degc: Temperature
    surface_salinity_psu: Salinity = 35.0
    deep_salinity_psu: Salinity = 35.0
    depth_m: Positive
    thickness_m: Positive

    def bends(self) -> FloatArray:
        """Return depths (m) at which the tables need additional points."""
        return self.depth_m + self.thickness_m * np.linspace(-2.0, 2.0, 401)

    def water_at(self, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return temperature (degC) and practical salinity at depths (m)."""
        part = 0.5 * (1.0 + np.tanh(2.0 * (depth - self.depth_m) / self.thickness_m))
        t0, t1, s0, s1 = (
            self.surface_temperature_degc, self.deep_temperature_degc, self.surface_salinity_psu, self.deep_salinity_psu,
        )  # fmt: skip
        return t0 + (t1 - t0) * part, s0 + (s1 - s0) * part


class TableColumn(ColumnTable, tag="table", kw_only=True, frozen=True):
    """A measured profile: in situ temperature and practical salinity at ascending depths, linear between them and constant beyond."""

    depth_m: Annotated[tuple[float, ...], Meta(min_length=2)]
    temperature_degc: tuple[Temperature, ...]
    salinity_psu: tuple[Salinity, ...]

    def __post_init__(self) -> None:
        """Raise ValueError unless the three make a table."""
        if not len(self.depth_m) == len(self.temperature_degc) == len(self.salinity_psu):
            raise ValueError("depth_m, temperature_degc and salinity_psu need the same number of values")
        if any(b <= a for a, b in zip(self.depth_m, self.depth_m[1:], strict=False)) or self.depth_m[0] < 0.0:
            raise ValueError("depth_m must begin at 0 or more, and rise from value to value")

    def bends(self) -> FloatArray:
        """Return depths (m) at which the tables need additional points."""
        return np.array(self.depth_m)

    def water_at(self, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return temperature (degC) and practical salinity at depths (m)."""
        return np.interp(depth, self.depth_m, self.temperature_degc), np.interp(depth, self.depth_m, self.salinity_psu)


ColumnConfig = ConstantColumn | ThermoclineColumn | TableColumn


class WaterColumn:
    """Still water as tables over depth. The tables are linear between two depths; above the surface the first value holds.

    The water has the composition of reference sea water, so that absolute salinity follows from practical salinity.

    Attributes:
        depth: (n) m, ascending from 0.
        temperature, salinity: (n) in situ temperature, degC; practical salinity.
        density: (n) kg/m3.
        sound_speed: (n) m/s.
        pressure: (n) pressure of the water above, Pa.
        ph: acidity.
        table: (n, 6) all of these, for compiled code.
    """

    def __init__(self, config: ColumnConfig, gravity: float, uniform_density: float, growth: float = 0.0) -> None:
        """Tabulate a column.

        Args:
            config: temperature and salinity.
            gravity: m/s2 at the surface.
            uniform_density: kg/m3, for `hydrostatics = "uniform"`.
            growth: relative growth of gravity with depth, 1/m.
        """
        bends = config.bends()
        self.depth = np.union1d(_GRID, bends[(bends > 0.0) & (bends < _GRID[-1])])
        self.temperature, self.salinity = config.water_at(self.depth)
        absolute = gsw.SR_from_SP(self.salinity)
        if config.hydrostatics == "uniform":
            self.density = np.full(self.depth.shape, uniform_density)
            self.pressure = uniform_density * gravity * self.depth * (1.0 + 0.5 * growth * self.depth)
        else:
            g = gravity * (1.0 + growth * self.depth)
            self.pressure, self.density = _hydrostatic(self.depth, absolute, self.temperature, g)
        sea = self.pressure / _DECIBAR
        self.sound_speed = gsw.sound_speed(absolute, gsw.CT_from_t(absolute, self.temperature, sea), sea)
        self.ph = config.ph
        self.table = np.column_stack(
            [self.depth, self.temperature, self.salinity, self.density, self.sound_speed, self.pressure]
        )
        # Look-ups in lists take a third of a microsecond, those in numpy arrays several.
        self._depth, self._pressure = self.depth.tolist(), self.pressure.tolist()
        self._temperature, self._salinity = self.temperature.tolist(), self.salinity.tolist()
        self._density, self._sound_speed = self.density.tolist(), self.sound_speed.tolist()

    def temperature_at(self, depth: float) -> float:
        """Return the in situ temperature, degC, at a depth (m, positive down)."""
        return _interpolated(self._depth, self._temperature, max(0.0, depth))

    def salinity_at(self, depth: float) -> float:
        """Return the practical salinity at a depth (m)."""
        return _interpolated(self._depth, self._salinity, max(0.0, depth))

    def density_at(self, depth: float) -> float:
        """Return the density in situ, kg/m3, at a depth (m)."""
        return _interpolated(self._depth, self._density, max(0.0, depth))

    def sound_speed_at(self, depth: float) -> float:
        """Return the speed of sound, m/s, at a depth (m)."""
        return _interpolated(self._depth, self._sound_speed, max(0.0, depth))

    def absorption_at(self, frequency_Hz: float, depth: float) -> float:
        """Return the absorption of sound, dB/m, after Francois and Garrison."""
        return absorption(frequency_Hz, self.temperature_at(depth), self.salinity_at(depth), depth, self.ph)

    def pressure_at(self, depth: float) -> float:
        """Return the pressure of the water above a depth (m), Pa; 0 above the surface."""
        return _interpolated(self._depth, self._pressure, max(0.0, depth))

    def depth_of(self, pressure: float) -> float:
        """Return the depth (m) of a pressure (Pa): the inverse of `pressure_at`, extrapolated upwards for negative pressures."""
        return _interpolated(self._pressure, self._depth, pressure)


def surface_density(config: ColumnConfig) -> float:
    """Return the density of a column at the surface, kg/m3 (TEOS-10)."""
    temperature, salinity = config.water_at(np.zeros(1))
    absolute = gsw.SR_from_SP(salinity)
    return float(gsw.rho(absolute, gsw.CT_from_t(absolute, temperature, 0.0), 0.0)[0])


@lru_cache(maxsize=64)
def uniform_column(density: float, temperature: float, gravity: float, growth: float = 0.0) -> WaterColumn:
    """Return water of one density (kg/m3) and temperature (degC) under p = rho g h; `growth` as for `WaterColumn`.

    Its salinity is the one with which TEOS-10 gives that density at the surface, limited to 0 to 42.
    """
    temperature = min(max(temperature, -2.0), 40.0)
    absolute = float(gsw.SA_from_rho(density, gsw.CT_from_t(15.0, temperature, 0.0), 0.0))
    if np.isnan(absolute):  # no sea water has this density
        absolute = 0.0 if density < 1010.0 else 42.0
    salinity = min(max(float(gsw.SP_from_SR(absolute)), 0.0), 42.0)
    config = ConstantColumn(temperature_degc=temperature, salinity_psu=salinity, hydrostatics="uniform")
    return WaterColumn(config, gravity, density, growth)


def _hydrostatic(
    depth: FloatArray, absolute: FloatArray, temperature: FloatArray, g: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return pressure of the water above (Pa) and density (kg/m3), such that the pressure is the integral of density times gravity."""
    steps = np.diff(depth)
    pressure = 1025.0 * g * depth
    density = np.zeros(depth.shape)
    for _ in range(8):  # each pass gains two digits, as water is nearly incompressible
        sea = pressure / _DECIBAR
        density = gsw.rho(absolute, gsw.CT_from_t(absolute, temperature, sea), sea)
        weight = density * g
        pressure = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * steps)])
    return pressure, density


def _interpolated(xs: Sequence[float], ys: Sequence[float], x: float) -> float:
    """Return y at x, linear between the points; beyond the ends the last interval is extrapolated."""
    k = min(max(bisect_right(xs, x), 1), len(xs) - 1)
    x0, y0 = xs[k - 1], ys[k - 1]
    return y0 + (ys[k] - y0) * ((x - x0) / (xs[k] - x0))
