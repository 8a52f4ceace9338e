"""The world of a recording, as far as it is told of: what it was called, who was there, and what of it is played."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from uwserver.ports import Port, Service
from uwserver.recording.player_items import Scene
from uwserver.recording.player_track import Track
from uwserver.simulation.source import Commanded, KnownMember
from uwserver.units import NANOSECONDS


@dataclass(frozen=True)
class _Vehicle:
    model: str


@dataclass(frozen=True)
class _Member:
    vehicle: _Vehicle


@dataclass
class PlayedWorld:
    """What is told of the world that was recorded, as it was at the time that is played."""

    name: str
    rate_hz: Fraction
    epoch_utc: str
    seed: int
    tick: int
    t_ns: int
    ports: Mapping[str, Port]
    services: Mapping[str, Service]
    members: Mapping[str, KnownMember]
    actuators: Mapping[str, Commanded] = field(default_factory=dict)
    readings_dropped: Mapping[str, int] = field(default_factory=dict)
    readings_failed: Mapping[str, int] = field(default_factory=dict)
    stops: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Range:
    """What is played: from and to a simulation time, s (None: the ends of the recording), and whether again and again."""

    from_s: float | None = None
    to_s: float | None = None
    loops: bool = False

    def fault(self, track: Track) -> str:
        """Why it cannot be played; "" where it can."""
        first, last = track.runs[0].from_ns / NANOSECONDS, max(run.to_ns for run in track.runs) / NANOSECONDS
        if self.from_s is not None and self.from_s > last:
            return f"the recording ends at {last:g} s: there is nothing from {self.from_s:g} s on"
        if self.to_s is not None and self.to_s <= max(first, self.from_s or 0.0):
            return f"nothing lies between {max(first, self.from_s or 0.0):g} and {self.to_s:g} s"
        return ""


def rate_of(track: Track) -> Fraction:
    """Ticks a second of the recorded world."""
    return Fraction(str(track.head.resolved.scenario.world.rate_hz))


def world_of(track: Track) -> PlayedWorld:
    """The world as it was when the recording began."""
    resolved, scene = track.head.resolved, track.scenes[0]
    return PlayedWorld(
        resolved.name, rate_of(track), resolved.scenario.world.epoch_utc, track.head.seed, 0, 0,
        scene.ports, scene.services, members_of(scene),
    )  # fmt: skip


def members_of(scene: Scene) -> Mapping[str, KnownMember]:
    """The bodies of a scene by name."""
    return {body.name: _Member(_Vehicle(body.model)) for body in scene.bodies}
