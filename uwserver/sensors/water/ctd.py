"""CTD: conductivity, temperature and pressure, and the salinity that such an instrument computes from the three."""

from __future__ import annotations

import math
from typing import Annotated

import gsw
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
        return Ctd(mount, self)


class CtdMemory(Memory):
    """Attributes:
    wet: it was under water at the last reading.
    temperature, conductivity: as thermistor (degC) and cell (S/m) had them then.
    temperature_offset, conductivity_offset, pressure_offset: constant errors, degC, S/m and Pa."""

    wet: bool = False
    temperature: Annotated[float, Meta(ge=-20, le=100)] = 0.0
    conductivity: Annotated[float, Meta(ge=0, le=100)] = 0.0
    temperature_offset: Annotated[float, Meta(ge=-100, le=100)] = 0.0
    conductivity_offset: Annotated[float, Meta(ge=-100, le=100)] = 0.0
    pressure_offset: Number = 0.0


class Ctd(Sensor):
    """Water at the mount."""

    doc = "Conductivity, temperature and pressure of the water, and the practical salinity computed from them; no values in air."
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
        if scope.submergence(p_NS) < 0.0:
            m.wet = False
            return Measurement(blank(self.fields), False)
        depth = p_NS[2]
        t, truth = water.temperature_at(depth), water.pressure(p_NS, scope.t)
        salinity, sea = water.salinity_at(depth), (truth - water.atmospheric_pressure) / _DECIBAR
        conductivity = 0.1 * float(gsw.C_from_SP(salinity, t, sea)) if salinity > 0.0 else 0.0
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


def practical_salinity(conductivity: float, temperature: float, sea_pressure: float) -> float:
    """PSS-78 with its extension below 2; 0 for what conducts less than fresh water, or is no water at all.

    Args:
        conductivity: S/m.
        temperature: degC, ITS-90.
        sea_pressure: dbar.
    """
    salinity = float(gsw.SP_from_C(10.0 * conductivity, temperature, sea_pressure))
    return salinity if salinity > 0.0 else 0.0  # gsw gives nan where there is none
