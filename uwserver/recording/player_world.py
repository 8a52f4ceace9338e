"""The recorded world during playback: its name, bodies and ports, and the range that is played."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from uwserver.ports import Port, Service
from uwserver.recording.player_items import Scene
from uwserver.recording.player_track import Track
from uwserver.units import NANOSECONDS
from uwserver.world.components import ActuatorSlot


@dataclass(frozen=True)
class _Vehicle:
    model: str


@dataclass(frozen=True)
class _Member:
    vehicle: _Vehicle


@dataclass
class PlayedWorld:
    """The recorded world at the time that is played, in the form in which adapters see a world."""

    name: str
    rate_hz: Fraction
    epoch_utc: str
    seed: int
    tick: int
    t_ns: int
    ports: Mapping[str, Port]
    services: Mapping[str, Service]
    members: Mapping[str, _Member]
    actuators: Mapping[str, ActuatorSlot] = field(default_factory=dict)
    readings_dropped: Mapping[str, int] = field(default_factory=dict)
    readings_failed: Mapping[str, int] = field(default_factory=dict)
    stops: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Range:
    """The range that is played: begin and end in simulation time, s (None: those of the recording), and whether it repeats."""

    from_s: float | None = None
    to_s: float | None = None
    loops: bool = False

    def fault(self, track: Track) -> str:
        """Return why the range cannot be played; "" if it can."""
        first, last = track.runs[0].from_ns / NANOSECONDS, max(run.to_ns for run in track.runs) / NANOSECONDS
        begin = max(first, self.from_s or 0.0)
        if self.from_s is not None and self.from_s > last:
            return f"the recording ends at {last:g} s: there is nothing from {self.from_s:g} s on"
        if self.to_s is not None and self.to_s <= begin:
            return f"the range from {begin:g} to {self.to_s:g} s is empty"
        return ""


def world_of(track: Track) -> PlayedWorld:
    """Return the world at the begin of the recording."""
    resolved, scene = track.head.resolved, track.scenes[0]
    world = resolved.scenario.world
    return PlayedWorld(
        resolved.name, Fraction(str(world.rate_hz)), world.epoch_utc, track.head.seed, 0, 0, scene.ports, scene.services, members_of(scene),
    )  # fmt: skip


def members_of(scene: Scene) -> Mapping[str, _Member]:
    """Return the bodies of a scene by name."""
    return {body.name: _Member(_Vehicle(body.model)) for body in scene.bodies}
