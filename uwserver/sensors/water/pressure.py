"""Pressure sensor: absolute pressure, or the depth that an instrument computes from it."""

from __future__ import annotations

from typing import Literal

import msgspec

from uwserver.ports import Field, Value
from uwserver.sensors.base import IdealSensor, Pose, Scope, SensorTable
from uwserver.table import NonNegative, Positive

_TEMPERATURE = Field("temperature", "degC", "temperature of the surrounding water")


class PressureConfig(SensorTable, tag="pressure", kw_only=True, frozen=True):
    """Attributes:
    output: "pressure" (Pa, absolute) or "depth" (m, positive down) that the instrument computes from it.
    assumed_density_kgpm3: the instrument inverts p = p_atm + rho g h with this density; default: the scenario's own relation of pressure and depth.
    assumed_atmosphere_pa: what the instrument believes; default: the truth of the scenario.
    """

    output: Literal["pressure", "depth"] = "pressure"
    assumed_density_kgpm3: Positive | msgspec.UnsetType = msgspec.UNSET
    assumed_atmosphere_pa: NonNegative | msgspec.UnsetType = msgspec.UNSET

    def build(self, mount: Pose) -> Pressure | Depth:
        return Pressure(mount) if self.output == "pressure" else Depth(mount, self)


class Pressure(IdealSensor):
    """Absolute pressure at the mount."""

    doc = "Absolute pressure at the mount."
    fields = (Field("pressure", "Pa", "absolute pressure"), _TEMPERATURE)

    def __init__(self, mount: Pose) -> None:
        self._mount = mount

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Always valid; atmospheric pressure above the surface."""
        p_NS = scope.position(self._mount.p)
        return True, [scope.water.pressure(p_NS, scope.t), scope.water.temperature_at(p_NS[2])]


class Depth(IdealSensor):
    """Depth as the instrument computes it from the pressure at its mount."""

    doc = (
        "Depth of the mount below the surface, computed from the pressure with the instrument's density and atmosphere."
    )
    fields = (Field("depth", "m", "depth below the surface, positive down"), _TEMPERATURE)

    def __init__(self, mount: Pose, config: PressureConfig) -> None:
        self._mount = mount
        self._config = config

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Above the surface the depth at atmospheric pressure: zero if the instrument knows the atmosphere. Invalid without gravity."""
        water, c = scope.water, self._config
        p_NS = scope.position(self._mount.p)
        temperature = water.temperature_at(p_NS[2])
        if water.gravity == 0.0:
            return False, [None, temperature]
        atmosphere = water.atmospheric_pressure if c.assumed_atmosphere_pa is msgspec.UNSET else c.assumed_atmosphere_pa
        gauge = water.pressure(p_NS, scope.t) - atmosphere
        if c.assumed_density_kgpm3 is msgspec.UNSET:
            return True, [water.column.depth_of(gauge), temperature]
        return True, [gauge / (c.assumed_density_kgpm3 * water.gravity), temperature]
