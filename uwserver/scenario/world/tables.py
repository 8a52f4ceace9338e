"""Tables of the world: its tick rate, its clock, and its place on the Earth."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from uwserver.table import Latitude, Name, NonNegative, Positive, Table


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
