"""What an adapter knows about the world without a request, as typed data."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Literal

from msgspec import Struct

from uwserver.units import NANOSECONDS


class VehicleFacts(Struct, frozen=True):
    """A vehicle of the scenario.

    Attributes:
        name: name in the scenario.
        model: name that the vehicle file gives to the model (``BlueROV2 Heavy``).
    """

    name: str
    model: str


class WorldFacts(Struct, frozen=True, kw_only=True):
    """The world at the time of asking.

    Attributes:
        server: name of the server.
        scenario: name of the scenario.
        rate_hz: physics ticks per simulated second.
        epoch_utc: UTC of simulation time zero, ISO 8601.
        mode: what sets the pace.
        speed: simulated seconds per second of wall time; it has a meaning only in mode realtime.
        vehicles: vehicles in the order of the scenario; spawned ones last.
    """

    server: str
    scenario: str
    rate_hz: float
    epoch_utc: str
    mode: Literal["realtime", "freerun", "lockstep"]
    speed: float
    vehicles: tuple[VehicleFacts, ...]

    @property
    def epoch_ns(self) -> int:
        """UTC of simulation time zero, ns since 1970."""
        epoch = datetime.fromisoformat(self.epoch_utc.replace("Z", "+00:00"))
        if epoch.tzinfo is None:
            epoch = epoch.replace(tzinfo=timezone.utc)
        return round(epoch.timestamp()) * NANOSECONDS
