"""The scenario file: one typed, frozen `Scenario`. Numbers as in the file: SI, but degrees where a key says `deg`.

Names of vehicles, sensors, actuators, modifiers and adapters are table names chosen by the user; they are the path on every wire. What a
component's table may hold is declared beside the component itself (`uwserver.sensors`, `uwserver.actuators`, `uwserver.modifiers`).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.autopilot.config import AutopilotConfig
from uwserver.environment.column import ColumnConfig, surface_density
from uwserver.environment.currents import CurrentConfig
from uwserver.environment.waves import WavesConfig
from uwserver.scenario.solids.tables import Latitude, ObjectEntry, Seabed, Structure
from uwserver.sensors import SensorConfig
from uwserver.sensors.truth import Truth
from uwserver.table import Name, NonNegative, Positive, Table, Vector3
from uwserver.units import STANDARD_ATMOSPHERE_PA
from uwserver.world.faults import FaultConfig


class Clock(Table, kw_only=True, frozen=True):
    """How simulation time passes.

    Attributes:
        mode: realtime (paced by the wall clock), freerun (as fast as possible) or lockstep (as far as the named clients allow).
        speed: simulated seconds per second in realtime.
        max_speed: in lockstep, no faster than this; default: as fast as the clients let it.
        paused: start paused.
        lockstep_clients: names that must all grant a tick.
        lockstep_timeout_s: wall time that the barrier waits for the slowest client; 0 waits for ever.
        on_loss: what happens when a client times out or leaves: wait for it, go on without it, or pause.
    """

    mode: Literal["realtime", "freerun", "lockstep"] = "realtime"
    speed: Positive = 1.0
    max_speed: Positive | UnsetType = UNSET
    paused: bool = False
    lockstep_clients: tuple[Name, ...] = ()
    lockstep_timeout_s: NonNegative = 10.0
    on_loss: Literal["wait", "continue", "pause"] = "wait"


class WorldTable(Table, kw_only=True, frozen=True):
    """Attributes:
    rate_hz: physics ticks a second; every sensor rate divides it.
    epoch_utc: RFC 3339 instant of t = 0.
    origin_lat_deg, origin_lon_deg: where N's origin lies (WGS84); needed by what is given in latitude and longitude.
    """

    rate_hz: Annotated[float, Meta(ge=1, le=10_000)] = 240.0
    epoch_utc: str = "2026-01-01T00:00:00Z"
    origin_lat_deg: Latitude | UnsetType = UNSET
    origin_lon_deg: float | UnsetType = UNSET
    clock: Clock = Clock()


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


class Copies(Table, kw_only=True, frozen=True):
    """Several vehicles from one table, ``<name>_1``, ``<name>_2`` and so on, in rows to the north and columns to the east.

    Attributes:
        count: of vehicles.
        columns: vehicles in a row; default: as many as makes a square.
        spacing_m: of rows and columns; the first vehicle is at `position_ned_m`.
    """

    count: Annotated[int, Meta(ge=1, le=1000)]
    columns: Annotated[int, Meta(ge=1)] | UnsetType = UNSET
    spacing_m: tuple[Positive, Positive] = (5.0, 5.0)


class VehicleEntry(Table, kw_only=True, frozen=True):
    """One vehicle of the scenario, or several alike.

    Attributes:
        model: name of a shipped vehicle file, or the path of one relative to the scenario file.
        copies: several of them in a grid; default: one, with the name of the table.
        present: False keeps it out at the start; ``world/spawn`` can add vehicles like it.
        override: tables of the vehicle file, key by key replaced for this vehicle.
        sensors: added to those of the vehicle file (same name: replaces it; ``enabled = false`` removes it).
        autopilot: the built-in one; default: none.
    """

    model: Name
    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    attitude_rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    velocity_frd_mps: Vector3 = (0.0, 0.0, 0.0)
    angular_velocity_frd_degps: Vector3 = (0.0, 0.0, 0.0)
    copies: Copies | UnsetType = UNSET
    present: bool = True
    truth: Truth | UnsetType = UNSET
    override: dict[str, Any] = field(default_factory=dict)
    sensors: dict[str, SensorConfig] = field(default_factory=dict)
    autopilot: AutopilotConfig | UnsetType = UNSET


class Server(Table, kw_only=True, frozen=True):
    """Attributes:
    name: how the server calls itself.
    metrics_bind, metrics_port: address of ``/health`` and ``/metrics`` (HTTP); port 0 takes a free one.
    metrics: serve them.
    uvloop: run the event loop of libuv, which answers faster under load; needs the extra `uvloop`.
    """

    name: Name = "uwserver"
    metrics: bool = True
    metrics_bind: str = "127.0.0.1"
    metrics_port: Annotated[int, Meta(ge=0, le=65535)] = 9600
    uvloop: bool = False


class Scenario(Table, kw_only=True, frozen=True):
    """A whole scenario file. `adapters` holds each adapter's own configuration type, chosen by its `kind`.

    Attributes:
        extensions: Python files, beside this one, with further kinds of sensor and modifier. They are run: do not load what you do not trust.
    """

    schema: Literal[1]
    title: str = ""
    extensions: tuple[Name, ...] = ()
    seed: Annotated[int, Meta(ge=0)] = 0
    world: WorldTable = WorldTable()
    environment: Environment = Environment()
    seabed: Seabed | UnsetType = UNSET
    structures: dict[str, Structure] = field(default_factory=dict)
    objects: dict[str, ObjectEntry] = field(default_factory=dict)
    vehicles: dict[str, VehicleEntry] = field(default_factory=dict)
    faults: dict[str, FaultConfig] = field(default_factory=dict)
    adapters: dict[str, Any] = field(default_factory=dict)
    server: Server = Server()
