"""Tables of the world itself: how fast it ticks, how its time passes, and where it lies."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from uwserver.table import Latitude, Name, NonNegative, Positive, Table


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
    earth: flat: N is an inertial frame, and gravity is the same at every depth. rotating: gyroscopes feel the Earth's rate and the transport
        rate, accelerometers what Coriolis' term adds, and gravity grows with depth; needs origin_lat_deg and origin_lon_deg. Default: rotating
        where these are given.
    engine: of contacts: auto (Bullet where it is installed, else coal), bullet or coal. A recording
        names the one that auto stood for.
    threads: that step the world, from 1 to 16: they share the loops over bodies, sensors and autopilots where there are enough of these. auto:
        two, if a trial in the first seconds finds that faster. The numbers are the same with any.
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
        """Latitude and longitude of N's origin, degrees; None where they are not both given."""
        if isinstance(self.origin_lat_deg, UnsetType) or isinstance(self.origin_lon_deg, UnsetType):
            return None
        return self.origin_lat_deg, self.origin_lon_deg

    @property
    def rotating(self) -> bool:
        """`earth` or its default: whether it turns."""
        return self.origin is not None if isinstance(self.earth, UnsetType) else self.earth == "rotating"
