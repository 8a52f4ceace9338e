"""CTD: conductivity, temperature and pressure, and the salinity computed from them."""

from __future__ import annotations

import math
from typing import Annotated, Any

from msgspec import Meta

from uwserver.environment.column import SALINITY, TEMPERATURE
from uwserver.environment.salinity import conductivity_of, practical_salinity
from uwserver.modifiers.base import Memory, Number
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable, Traits
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
    TableSensor,
    gauge_pressure,
    loop,
    p_NS,
    place_of,
    record,
    submergence,
    water_property,
)
from uwserver.table import NonNegative

_DECIBAR = 1e4


class CtdConfig(SensorTable, tag="ctd", kw_only=True, frozen=True):
    """A CTD. If the lags of thermistor and cell differ, fast changes give spikes of salinity, as in a real cast.

    Attributes:
        ideal: exact and without lag, whatever the other keys say.
        temperature_accuracy_degc, conductivity_accuracy_Spm, pressure_accuracy_Pa: standard deviation of constant errors, drawn once a run.
        temperature_sigma_degc, conductivity_sigma_Spm, pressure_sigma_Pa: standard deviation of white noise.
        temperature_lag_s, conductivity_lag_s: time constants of thermistor and cell.
    """

    message = "Ctd"
    ideal: bool = False
    temperature_accuracy_degc: NonNegative = 0.0
    conductivity_accuracy_Spm: NonNegative = 0.0
    pressure_accuracy_Pa: NonNegative = 0.0
    temperature_sigma_degc: NonNegative = 0.0
    conductivity_sigma_Spm: NonNegative = 0.0
    pressure_sigma_Pa: NonNegative = 0.0
    temperature_lag_s: NonNegative = 0.0
    conductivity_lag_s: NonNegative = 0.0

    def traits(self) -> Traits:
        """Declare its errors, constant and white."""
        temperature = math.hypot(self.temperature_sigma_degc, self.temperature_accuracy_degc)
        conductivity = math.hypot(self.conductivity_sigma_Spm, self.conductivity_accuracy_Spm)
        pressure = math.hypot(self.pressure_sigma_Pa, self.pressure_accuracy_Pa)
        return Traits(sigmas={"temperature": (temperature,), "conductivity": (conductivity,), "pressure": (pressure,)})

    def build(self, mount: Pose) -> Ctd:
        return Ctd(mount, self)


class CtdMemory(Memory):
    """Attributes:
    wet: 1 if it was under water at the last reading.
    temperature, conductivity: values of thermistor (degC) and cell (S/m) at the last reading.
    temperature_offset, conductivity_offset, pressure_offset: constant errors, degC, S/m and Pa."""

    wet: Annotated[int, Meta(ge=0, le=1)] = 0
    temperature: Annotated[float, Meta(ge=-20, le=100)] = 0.0
    conductivity: Annotated[float, Meta(ge=0, le=100)] = 0.0
    temperature_offset: Annotated[float, Meta(ge=-100, le=100)] = 0.0
    conductivity_offset: Annotated[float, Meta(ge=-100, le=100)] = 0.0
    pressure_offset: Number = 0.0


_RECORD = record(
    [
        ("temperature_lag", "f8"), ("conductivity_lag", "f8"),
        ("temperature_sigma", "f8"), ("conductivity_sigma", "f8"), ("pressure_sigma", "f8"),
    ],
    [
        ("wet", "i8"), ("temperature", "f8"), ("conductivity", "f8"),
        ("temperature_offset", "f8"), ("conductivity_offset", "f8"), ("pressure_offset", "f8"),
    ],
)  # fmt: skip


@compiled
def _lag_response(dt: float, lag: float) -> float:
    """Return the part of a step that a first-order lag follows within dt (s)."""
    return 1.0 if lag == 0.0 else -math.expm1(-dt / lag)


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the properties of the water; invalid in air."""
    m, p = row.m, p_NS(head, surroundings)
    if submergence(surroundings, p, t) < 0.0:
        m.wet, head.valid = 0, 0
        out[:] = MISSING
        return
    temperature, salinity = (
        water_property(surroundings, TEMPERATURE, p[2]),
        water_property(surroundings, SALINITY, p[2]),
    )
    gauge, atmosphere, conductivity = gauge_pressure(surroundings, p, t), place_of(surroundings).atmosphere, 0.0
    if salinity > 0.0:
        conductivity = conductivity_of(salinity, temperature, gauge / _DECIBAR)
    if m.wet != 0 and head.exact == 0:
        temperature = m.temperature + (temperature - m.temperature) * _lag_response(head.dt, row.temperature_lag)
        conductivity = m.conductivity + (conductivity - m.conductivity) * _lag_response(head.dt, row.conductivity_lag)
    m.temperature, m.conductivity, m.wet = temperature, conductivity, 1
    if head.exact == 0:
        a, b = normals(head.key, head.number, SAMPLE, 0)
        c, _ = normals(head.key, head.number, SAMPLE, 1)
        temperature += m.temperature_offset + row.temperature_sigma * a
        conductivity += m.conductivity_offset + row.conductivity_sigma * b
        gauge += m.pressure_offset + row.pressure_sigma * c
    out[0], out[1], out[2] = conductivity, temperature, atmosphere + gauge
    out[3] = practical_salinity(conductivity, temperature, gauge / _DECIBAR)


class Ctd(TableSensor[CtdConfig]):
    """Water at the mount."""

    doc = "Conductivity, temperature and pressure of the water, and the practical salinity computed from them; no values in air."
    fields = (
        Field("conductivity", "S/m", "electrical conductivity"),
        Field("temperature", "degC", "in situ temperature"),
        Field("pressure", "Pa", "absolute pressure"),
        Field("salinity", "1", "practical salinity (PSS-78)"),
    )
    kernel = SensorKernel(_RECORD, loop(measure))
    random = ("temperature_sigma", "conductivity_sigma", "pressure_sigma")
    memory_type = CtdMemory

    def fill(self, row: Any) -> None:
        c = self._config
        row["temperature_lag"], row["conductivity_lag"] = c.temperature_lag_s, c.conductivity_lag_s
        row["temperature_sigma"], row["conductivity_sigma"] = c.temperature_sigma_degc, c.conductivity_sigma_Spm
        row["pressure_sigma"] = c.pressure_sigma_Pa

    def turn_on_row(self, memory: Any) -> None:
        """Draw the constant errors."""
        c, (t, s, p) = self._config, self.drawn(3).tolist()
        memory["temperature_offset"] = c.temperature_accuracy_degc * t
        memory["conductivity_offset"] = c.conductivity_accuracy_Spm * s
        memory["pressure_offset"] = c.pressure_accuracy_Pa * p
