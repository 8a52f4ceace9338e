"""What a server needs of whatever gives it samples: a world that is stepped (`uwserver.simulation.thread`), or a recording that is played."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Protocol

from uwserver.ports import Json, OnReply, Port, Service
from uwserver.simulation.clock import Pace, Timing
from uwserver.simulation.lateness import Lateness
from uwserver.simulation.lockstep import Lockstep
from uwserver.simulation.readers import OnSamples, OnState


class KnownVehicle(Protocol):
    """A body's kind."""

    @property
    def model(self) -> str:
        """Name of its file."""


class KnownMember(Protocol):
    """A body."""

    @property
    def vehicle(self) -> KnownVehicle:
        """What it is."""


class Commanded(Protocol):
    """An actuator."""

    @property
    def conflicts(self) -> int:
        """How often two commanded it."""


class KnownWorld(Protocol):
    """What is told of a world, immutable or replaced as a whole; `tick` and `t_ns` are numbers that any thread may read."""

    @property
    def name(self) -> str:
        """Of the scenario."""

    @property
    def rate_hz(self) -> Fraction:
        """Ticks a second."""

    @property
    def epoch_utc(self) -> str:
        """UTC of time zero."""

    @property
    def seed(self) -> int:
        """Of the run."""

    @property
    def tick(self) -> int:
        """Where it stands."""

    @property
    def t_ns(self) -> int:
        """Simulation time there, ns."""

    @property
    def ports(self) -> Mapping[str, Port]:
        """By path."""

    @property
    def services(self) -> Mapping[str, Service]:
        """By path."""

    @property
    def members(self) -> Mapping[str, KnownMember]:
        """Bodies by name."""

    @property
    def actuators(self) -> Mapping[str, Commanded]:
        """By path."""

    @property
    def readings_dropped(self) -> Mapping[str, int]:
        """Readings that were not computed in time, by port."""

    @property
    def readings_failed(self) -> Mapping[str, int]:
        """Readings that could not be computed, by port."""

    @property
    def stops(self) -> Mapping[str, int]:
        """How often compiled ticks have needed Python, by what for."""


class Reads(Protocol):
    """As `uwserver.simulation.readers.Readers`."""

    def read(self, ports: Sequence[str], on_samples: OnSamples, source: str = "") -> None:
        """Ask for the newest samples of some ports."""

    def look(self, on_state: OnState, source: str = "") -> None:
        """Ask where all bodies are."""


class Source(Protocol):
    """As `uwserver.simulation.thread.Simulation`, where each of these is described.

    Attributes:
        until_tick: `run` ends at this tick; None for never.
    """

    until_tick: int | None

    @property
    def world(self) -> KnownWorld:
        """What is shown."""

    @property
    def timing(self) -> Timing:
        """How its time passes."""

    @property
    def pace(self) -> Pace:
        """Its speed."""

    @property
    def lateness(self) -> Lateness:
        """Of its ticks."""

    @property
    def lockstep(self) -> Lockstep:
        """Who grants ticks."""

    @property
    def readers(self) -> Reads:
        """Who reads."""

    @property
    def paused(self) -> bool:
        """Whether time stands still."""

    @property
    def failure(self) -> str:
        """Why it ended; "" while all is well."""

    def call(
        self, service: str, args: Mapping[str, Json], client: str, on_reply: OnReply, source: str = ""
    ) -> Callable[[], bool]:
        """Start a service of the clock."""

    def run(self) -> None:
        """The body of its thread."""

    def stop(self) -> None:
        """End it."""
