"""CTD: conductivity, temperature and pressure, and the salinity that such an instrument computes from the three."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta

from uwserver.modifiers.base import Measurement, Memory, Number
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, blank
from uwserver.table import NonNegative

_DECIBAR = 1e4


class CtdConfig(SensorTable, tag="ctd", kw_only=True, frozen=True):
    """A CTD. Different lags of thermistor and cell give the spikes of salinity that a fast change makes in a real cast.

    Attributes:
        ideal: exact and without lag, whatever else is given.
        temperature_accuracy_degc, conductivity_accuracy_Spm, pressure_accuracy_Pa: standard deviation of constant errors, drawn once a run.
        temperature_sigma_degc, conductivity_sigma_Spm, pressure_sigma_Pa: standard deviation of white noise.
        temperature_lag_s, conductivity_lag_s: time constants.
    """

    ideal: bool = False
    temperature_accuracy_degc: NonNegative = 0.0
    conductivity_accuracy_Spm: NonNegative = 0.0
    pressure_accuracy_Pa: NonNegative = 0.0
    temperature_sigma_degc: NonNegative = 0.0
    conductivity_sigma_Spm: NonNegative = 0.0
    pressure_sigma_Pa: NonNegative = 0.0
    temperature_lag_s: NonNegative = 0.0
    conductivity_lag_s: NonNegative = 0.0

    def build(self, mount: Pose) -> Ctd:
        """The instrument."""
        return Ctd(mount, self)


class CtdMemory(Memory):
    """Attributes:
    wet: it was under water at the last reading.
    temperature, conductivity: as thermistor (degC) and cell (S/m) had them then.
    temperature_offset, conductivity_offset, pressure_offset: constant errors, degC, S/m and Pa."""

    wet: bool = False
    temperature: Annotated[float, Meta(ge=-20, le=100)] = 0.0
    conductivity: Annotated[float, Meta(ge=0, le=100)] = 0.0
    temperature_offset: Number = 0.0
    conductivity_offset: Number = 0.0
    pressure_offset: Number = 0.0


class Ctd(Sensor):
    """Water at the mount."""

    doc = "Conductivity, temperature and pressure of the water, and the practical salinity computed from them; nothing in air."
    fields = (
        Field("conductivity", "S/m", "electrical conductivity"),
        Field("temperature", "degC", "in situ"),
        Field("pressure", "Pa", "absolute pressure"),
        Field("salinity", "1", "practical salinity (PSS-78)"),
    )

    memory: CtdMemory

    def __init__(self, mount: Pose, config: CtdConfig) -> None:
        self._mount = mount
        self._config = CtdConfig(rate_hz=config.rate_hz) if config.ideal else config
        super().__init__()

    def turn_on(self) -> CtdMemory:
        """Constant errors; no water yet."""
        c = self._config
        t, s, p = self.rng.standard_normal(3).tolist()
        return CtdMemory(
            temperature_offset=c.temperature_accuracy_degc * t,
            conductivity_offset=c.conductivity_accuracy_Spm * s,
            pressure_offset=c.pressure_accuracy_Pa * p,
        )

    def sense(self, scope: Scope) -> Measurement:
        """Invalid in air."""
        c, m, water = self._config, self.memory, scope.water
        p_NS = scope.position(self._mount.p)
        draws = self.rng.standard_normal(3).tolist()
        depth = p_NS[2]
        if depth + water.elevation(p_NS[0], p_NS[1], scope.t) < 0.0:
            m.wet = False
            return Measurement(blank(self.fields), False)
        t, truth = water.temperature_at(depth), water.pressure(p_NS, scope.t)
        conductivity = conductivity_of(water.salinity_at(depth), t, (truth - water.atmospheric_pressure) / _DECIBAR)
        if m.wet:
            t = m.temperature + (t - m.temperature) * _share(self.dt, c.temperature_lag_s)
            conductivity = m.conductivity + (conductivity - m.conductivity) * _share(self.dt, c.conductivity_lag_s)
        m.temperature, m.conductivity, m.wet = t, conductivity, True
        t += m.temperature_offset + c.temperature_sigma_degc * draws[0]
        conductivity += m.conductivity_offset + c.conductivity_sigma_Spm * draws[1]
        pressure = truth + m.pressure_offset + c.pressure_sigma_Pa * draws[2]
        sea = (pressure - water.atmospheric_pressure) / _DECIBAR
        return Measurement([conductivity, t, pressure, practical_salinity(conductivity, t, sea)], True)


def _share(dt: float, lag: float) -> float:
    """How far a first-order lag follows within dt (s)."""
    return 1.0 if lag == 0.0 else -math.expm1(-dt / lag)


_A = (0.0080, -0.1692, 25.3851, 14.0941, -7.0261, 2.7081)
_B = (0.0005, -0.0056, -0.0066, -0.0375, 0.0636, -0.0144)
_RT = (0.6766097, 2.00564e-2, 1.104259e-4, -6.9698e-7, 1.0031e-9)
_STANDARD = 4.2914
"""Conductivity of sea water of salinity 35 at 15 degC (IPTS-68) and sea level, S/m, as TEOS-10 takes it."""


def practical_salinity(conductivity: float, temperature: float, sea_pressure: float) -> float:
    """PSS-78 (UNESCO Technical Paper 44, 1983), with Hill's extension (1986) below 2.

    Args:
        conductivity: S/m; not positive gives 0.
        temperature: degC, ITS-90.
        sea_pressure: dbar.
    """
    if conductivity <= 0.0:
        return 0.0
    t, p = 1.00024 * temperature, sea_pressure
    ratio = conductivity / _STANDARD
    rp = 1.0 + p * (2.070e-5 - 6.370e-10 * p + 3.989e-15 * p * p) / (
        1.0 + 3.426e-2 * t + 4.464e-4 * t * t + (4.215e-1 - 3.107e-3 * t) * ratio
    )
    r = ratio / (rp * _polynomial(_RT, t))
    root, part = math.sqrt(r), (t - 15.0) / (1.0 + 0.0162 * (t - 15.0))
    salinity = _pss78(root, part)
    if salinity < 2.0:
        salinity = _hill(root, part) * 2.0 / _hill(_root_at_2(part), part)
    return max(0.0, salinity)


def conductivity_of(salinity: float, temperature: float, sea_pressure: float) -> float:
    """Conductivity (S/m) at which `practical_salinity` gives this salinity, by the secant method."""
    before, after = 0.0, _STANDARD * (salinity + 0.01) / 35.0
    error_before, error = -salinity, practical_salinity(after, temperature, sea_pressure) - salinity
    for _ in range(20):
        if abs(error) < 1e-12 or error == error_before:
            break
        before, after = after, max(0.0, after - error * (after - before) / (error - error_before))
        error_before, error = error, practical_salinity(after, temperature, sea_pressure) - salinity
    return after


def _pss78(root: float, part: float) -> float:
    return _polynomial(_A, root) + part * _polynomial(_B, root)


def _hill(root: float, part: float) -> float:
    x, y = 400.0 * root * root, 10.0 * root
    return _pss78(root, part) - _A[0] / (1.0 + 1.5 * x + x * x) - _B[0] * part / (1.0 + y + y * y + y * y * y)


def _root_at_2(part: float) -> float:
    """Root of the conductivity ratio at salinity 2: there TEOS-10 scales Hill's extension so that both meet."""
    root = 0.26
    for _ in range(4):
        slope = sum(k * (a + part * b) * root ** (k - 1) for k, (a, b) in enumerate(zip(_A, _B, strict=True)) if k)
        root -= (_pss78(root, part) - 2.0) / slope
    return root


def _polynomial(coefficients: tuple[float, ...], x: float) -> float:
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * x + coefficient
    return value
