"""The table `environment`: water, currents and waves."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.environment.column import ColumnConfig, surface_density
from uwserver.environment.currents import CurrentConfig
from uwserver.environment.waves import WavesConfig
from uwserver.table import NonNegative, Table, Vector3
from uwserver.units import STANDARD_ATMOSPHERE_PA

SEA_WATER_KGPM3 = 1025.0
"""Density where nobody says what the water is like."""


class Current(Table, kw_only=True, frozen=True):
    """Uniform, steady current; `velocity_ned_mps` is the water's velocity in N."""

    velocity_ned_mps: Vector3 = (0.0, 0.0, 0.0)


class Environment(Table, kw_only=True, frozen=True):
    """Water and gravity. The sea surface at rest is the plane z = 0 of N.

    Attributes:
        density_kgpm3: which forces act with, at every depth; default: that of `water` at the surface, or 1025.
        surface_level_m: of the still surface above z = 0, as the tide has it.
        water: temperature and salinity over depth, from which sea water's density, pressure, sound speed and absorption follow (TEOS-10);
            default: uniform water of `density_kgpm3` and `temperature_degc` under p = rho g h.
        current: uniform, steady current.
        currents: more of them, by name; all add up.
        waves: of the surface; default: none.
    """

    density_kgpm3: Annotated[float, Meta(ge=500, le=1500)] | UnsetType = UNSET
    gravity_mps2: Annotated[float, Meta(ge=0, le=30)] = 9.81
    temperature_degc: Annotated[float, Meta(ge=-5, le=60)] = 10.0
    atmospheric_pressure_pa: NonNegative = STANDARD_ATMOSPHERE_PA
    surface_level_m: Annotated[float, Meta(ge=-20, le=20)] = 0.0
    current: Current = Current()
    water: ColumnConfig | UnsetType = UNSET
    currents: dict[str, CurrentConfig] = field(default_factory=dict)
    waves: WavesConfig | UnsetType = UNSET

    @property
    def density(self) -> float:
        """`density_kgpm3` or its default, kg/m3."""
        if not isinstance(self.density_kgpm3, UnsetType):
            return self.density_kgpm3
        if isinstance(self.water, UnsetType) or self.water.hydrostatics == "uniform":
            return SEA_WATER_KGPM3
        return surface_density(self.water)
