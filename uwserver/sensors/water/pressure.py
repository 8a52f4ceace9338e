"""Pressure sensor: absolute pressure, or the depth that the instrument computes from it."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from uwserver.environment.column import TEMPERATURE
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
    TableSensor,
    depth_of,
    gauge_pressure,
    loop,
    p_NS,
    place_of,
    record,
    water_property,
)
from uwserver.table import NonNegative, Positive

_TEMPERATURE = Field("temperature", "degC", "temperature of the surrounding water")


class PressureConfig(SensorTable, tag="pressure", kw_only=True, frozen=True):
    """Attributes:
    output: "pressure" (Pa, absolute), or "depth" (m, positive down), which the instrument computes from it.
    assumed_density_kgpm3: density with which the instrument inverts p = p_atm + rho g h; default: the true relation of pressure and depth.
    assumed_atmosphere_pa: atmospheric pressure that the instrument assumes; default: the true one.
    """

    message = "FluidPressure"
    output: Literal["pressure", "depth"] = "pressure"
    assumed_density_kgpm3: Positive | msgspec.UnsetType = msgspec.UNSET
    assumed_atmosphere_pa: NonNegative | msgspec.UnsetType = msgspec.UNSET

    def build(self, mount: Pose) -> Pressure | Depth:
        return Pressure(mount, self) if self.output == "pressure" else Depth(mount, self)


_RECORD = record([("depth", "i8"), ("scale", "f8"), ("atmosphere", "f8")])


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the pressure or the depth, and the temperature."""
    p, place = p_NS(head, surroundings), place_of(surroundings)
    gauge = gauge_pressure(surroundings, p, t)
    out[1] = water_property(surroundings, TEMPERATURE, p[2])
    if row.depth == 0:
        out[0] = place.atmosphere + gauge
        return
    if place.gravity == 0.0:
        out[0], head.valid = MISSING, 0
        return
    if row.atmosphere >= 0.0:
        gauge += place.atmosphere - row.atmosphere
    out[0] = gauge / (row.scale * place.gravity) if row.scale > 0.0 else depth_of(surroundings, gauge)


class _Manometer(TableSensor[PressureConfig]):
    kernel = SensorKernel(_RECORD, loop(measure))
    exact = True

    def fill(self, row: Any) -> None:
        c = self._config
        row["depth"] = c.output == "depth"
        row["scale"] = 0.0 if c.assumed_density_kgpm3 is msgspec.UNSET else c.assumed_density_kgpm3
        row["atmosphere"] = -1.0 if c.assumed_atmosphere_pa is msgspec.UNSET else c.assumed_atmosphere_pa


class Pressure(_Manometer):
    """Absolute pressure at the mount. Always valid; atmospheric pressure above the surface."""

    doc = "Absolute pressure at the mount."
    fields = (Field("pressure", "Pa", "absolute pressure"), _TEMPERATURE)


class Depth(_Manometer):
    """Depth as the instrument computes it from the pressure at its mount.

    Above the surface this is the depth at atmospheric pressure, which is zero if the instrument assumes the true one. Invalid without gravity.
    """

    doc = (
        "Depth of the mount below the surface, computed from the pressure with the instrument's density and atmosphere."
    )
    fields = (Field("depth", "m", "depth below the surface, positive down"), _TEMPERATURE)
