"""The tables `world` (tick rate, clock and place on the Earth) and `environment` (water, daylight, currents and waves)."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType, field
from msgspec.structs import replace

from uwserver.environment.column import ColumnConfig, surface_density
from uwserver.environment.currents import CurrentConfig
from uwserver.environment.earth import GRAVITY_GROWTH, normal_gravity
from uwserver.environment.light import Daylight, WaterType
from uwserver.environment.waves import WavesConfig
from uwserver.table import Latitude, Name, NonNegative, Positive, Probability, Table, Vector3
from uwserver.units import STANDARD_ATMOSPHERE_PA, rad

SEA_WATER_KGPM3 = 1025.0
"""Default density of the water."""
GRAVITY_MPS2 = 9.81
"""Gravity if the scenario has no place on the Earth."""


class Clock(Table, kw_only=True, frozen=True):
    """How fast simulation time passes.

    Attributes:
        mode: realtime (paced by the wall clock), freerun (as fast as possible) or lockstep (as far as the named clients allow).
        speed: simulated seconds per second in realtime.
        max_speed: highest speed in lockstep; default: as fast as the clients allow.
        paused: whether to start paused.
        lockstep_clients: names of the clients that must all grant each tick.
        lockstep_timeout_s: wall time that the world waits for the slowest client; 0 waits without a limit.
        on_loss: what happens if a client times out or leaves: wait for it, continue without it, or pause.
    """

    mode: Literal["realtime", "freerun", "lockstep"] = "realtime"
    speed: Positive = 1.0
    max_speed: Positive | UnsetType = UNSET
    paused: bool = False
    lockstep_clients: tuple[Name, ...] = ()
    lockstep_timeout_s: NonNegative = 10.0
    on_loss: Literal["wait", "continue", "pause"] = "wait"


class WorldTable(Table, kw_only=True, frozen=True):
    """The world: rates, time and place.

    Attributes:
        rate_hz: physics ticks per second; every sensor rate must divide it.
        epoch_utc: RFC 3339 instant of t = 0.
        origin_lat_deg, origin_lon_deg: place of the origin of N (WGS84); needed for everything that is given in latitude and longitude.
        earth: flat: N is an inertial frame, and gravity is the same at every depth. rotating: gyroscopes measure the Earth's rate and the
            transport rate, accelerometers the Coriolis term, and gravity grows with depth; needs origin_lat_deg and origin_lon_deg. Default:
            rotating if these are given.
        engine: for contacts: auto (Bullet if it is installed, else coal), bullet or coal. A recording has the name of the engine that auto chose.
        threads: number of threads that step the world, from 1 to 16. They share the loops over bodies, sensors and autopilots if there are
            enough of these. auto: two, if a trial in the first seconds finds that faster. The results do not depend on the number.
    """

    rate_hz: Annotated[float, Meta(ge=1, le=10_000)] = 240.0
    epoch_utc: str = "2026-01-01T00:00:00Z"
    origin_lat_deg: Latitude | UnsetType = UNSET
    origin_lon_deg: float | UnsetType = UNSET
    earth: Literal["flat", "rotating"] | UnsetType = UNSET
    engine: Literal["auto", "bullet", "coal"] = "auto"
    threads: Literal["auto"] | Annotated[int, Meta(ge=1, le=16)] = "auto"
    clock: Clock = Clock()

    @property
    def origin(self) -> tuple[float, float] | None:
        """Latitude and longitude of N's origin, degrees; None unless both are given."""
        if isinstance(self.origin_lat_deg, UnsetType) or isinstance(self.origin_lon_deg, UnsetType):
            return None
        return self.origin_lat_deg, self.origin_lon_deg

    @property
    def rotating(self) -> bool:
        """Whether the Earth rotates: `earth` or its default."""
        return self.origin is not None if isinstance(self.earth, UnsetType) else self.earth == "rotating"


# -- environment ------------------------------------------------------------------------------------------------------------------------


class Current(Table, kw_only=True, frozen=True):
    """A uniform, steady current; `velocity_ned_mps` is the velocity of the water in N."""

    velocity_ned_mps: Vector3 = (0.0, 0.0, 0.0)


class DaylightTable(Table, kw_only=True, frozen=True):
    """Light from above. Only cameras use it.

    Attributes:
        illuminance_lux: on the surface; 100000 at noon, 10000 under clouds, 0 at night.
        sun_elevation_deg: above the horizon.
        sun_azimuth_deg: clockwise from north.
        sky: part of the light that comes from the whole sky; 1 if it is overcast.
    """

    illuminance_lux: Annotated[float, Meta(ge=0, le=200_000)] = 60_000.0
    sun_elevation_deg: Annotated[float, Meta(ge=1, le=90)] = 50.0
    sun_azimuth_deg: Annotated[float, Meta(ge=-400, le=400)] = 0.0
    sky: Probability = 0.25

    @property
    def daylight(self) -> Daylight:
        """The same in radians."""
        return Daylight(self.illuminance_lux, rad(self.sun_elevation_deg), rad(self.sun_azimuth_deg), self.sky)


class Environment(Table, kw_only=True, frozen=True):
    """Water and gravity. The sea surface at rest is the plane z = 0 of N.

    Attributes:
        density_kgpm3: density with which forces act, at every depth; default: that of `water` at the surface, or 1025.
        gravity_mps2: gravity at the surface, for weight, buoyancy, pressure, waves and accelerometers; default: that of the ellipsoid at
            `[world] origin_lat_deg` (WGS 84, Somigliana), or 9.81.
        gravity_growth_pm: relative growth of gravity per metre of depth; default: 2.26e-7 (TEOS-10) on a rotating Earth, else 0.
        surface_level_m: height of the still surface above z = 0, such as that of the tide.
        water: temperature and salinity over depth, from which density, pressure, sound speed and absorption follow (TEOS-10); default: uniform
            water of `density_kgpm3` and `temperature_degc` under p = rho g h.
        water_type: clarity of the water by Jerlov: I, IA, IB, II and III for the open sea, 1C, 3C, 5C, 7C and 9C for coasts. Only cameras and
            pictures use it.
        daylight: light from above.
        current: uniform, steady current.
        currents: more currents, by name; all currents add up.
        waves: waves of the surface; default: none.
    """

    density_kgpm3: Annotated[float, Meta(ge=500, le=1500)] | UnsetType = UNSET
    gravity_mps2: Annotated[float, Meta(ge=0, le=30)] | UnsetType = UNSET
    gravity_growth_pm: Annotated[float, Meta(ge=0, le=1e-5)] | UnsetType = UNSET
    temperature_degc: Annotated[float, Meta(ge=-5, le=60)] = 10.0
    atmospheric_pressure_pa: NonNegative = STANDARD_ATMOSPHERE_PA
    surface_level_m: Annotated[float, Meta(ge=-20, le=20)] = 0.0
    water_type: WaterType = "II"
    daylight: DaylightTable = DaylightTable()
    current: Current = Current()
    water: ColumnConfig | UnsetType = UNSET
    currents: dict[str, CurrentConfig] = field(default_factory=dict)
    waves: WavesConfig | UnsetType = UNSET

    def on_earth(self, latitude: float | None, rotating: bool) -> Environment:
        """Return the same table with gravity filled in; where none is given, from the place on the Earth.

        Args:
            latitude: of N's origin, rad; None if there is none.
            rotating: whether the Earth rotates and is round.
        """
        gravity, growth = self.gravity, self.growth
        if latitude is not None and isinstance(self.gravity_mps2, UnsetType):
            gravity = normal_gravity(latitude)
        if rotating and isinstance(self.gravity_growth_pm, UnsetType):
            growth = GRAVITY_GROWTH
        return replace(self, gravity_mps2=gravity, gravity_growth_pm=growth)

    @property
    def gravity(self) -> float:
        """`gravity_mps2` or its default, m/s2."""
        return GRAVITY_MPS2 if isinstance(self.gravity_mps2, UnsetType) else self.gravity_mps2

    @property
    def growth(self) -> float:
        """`gravity_growth_pm` or its default, 1/m."""
        return 0.0 if isinstance(self.gravity_growth_pm, UnsetType) else self.gravity_growth_pm

    @property
    def density(self) -> float:
        """`density_kgpm3` or its default, kg/m3."""
        if not isinstance(self.density_kgpm3, UnsetType):
            return self.density_kgpm3
        if isinstance(self.water, UnsetType) or self.water.hydrostatics == "uniform":
            return SEA_WATER_KGPM3
        return surface_density(self.water)
