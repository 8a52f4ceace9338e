"""The recorded world during playback, as clients see it: its name, bodies, ports and services, and the range that is played."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from uwserver.ports import Argument, Fault, Port, Service
from uwserver.recording.player.messages import Scene
from uwserver.recording.player.track import Track
from uwserver.simulation.thread import CLOCK_SERVICES
from uwserver.units import NANOSECONDS
from uwserver.world.stepping.commands import ActuatorSlot

DEFAULT = -1
"""Value of an argument that leaves a setting as it is."""
_SERVERS = frozenset(("world/describe", "world/status", "world/shutdown"))


@dataclass(frozen=True)
class _Vehicle:
    model: str
    is_held: bool = False


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


PLAYBACK_SERVICES = (
    Service("playback/pause", "Pause, like world/pause."),
    Service("playback/resume", "Resume, like world/resume; at the end of the recording playback begins again."),
    Service(
        "playback/seek",
        "Go to a time. An event reset announces it, and each port gives its last sample before that time.",
        (
            Argument("t_s", "float", "simulation time of the recording", "s", minimum=0.0, maximum=1e9),
            Argument("run", "int", "which run between resets; default: the current", required=False, default=DEFAULT, minimum=-1, maximum=1e9),
        ),
    ),
    Service(
        "playback/speed",
        "Simulated seconds per second of the wall clock.",
        (Argument("speed", "float", "factor; 0 for as fast as possible", minimum=0.0, maximum=1000.0),),
    ),
    Service(
        "playback/loop",
        "Play a range repeatedly, or once.",
        (
            Argument("on", "bool", "false: pause at the end of the range", required=False, default=True),
            Argument("from_s", "float", "its begin; default: unchanged", "s", required=False, default=float(DEFAULT), minimum=-1.0, maximum=1e9),
            Argument("to_s", "float", "its end; default: unchanged", "s", required=False, default=float(DEFAULT), minimum=-1.0, maximum=1e9),
        ),
    ),
    Service(
        "playback/step",
        "Advance by n ticks and pause there. A negative number goes back, which is a seek.",
        (Argument("n", "int", "ticks", required=False, default=1, minimum=-1e9, maximum=1e9),),
        long_running=True,
    ),
    Service("playback/state", "Return file, time, range, speed, runs, and the events of the file as marks.", reads_only=True),
)  # fmt: skip
SERVICES = {service.path: service for service in (*CLOCK_SERVICES, *PLAYBACK_SERVICES)}
"""All services that control the playback."""


def objection(path: str) -> Fault | None:
    """Return why a command to a port, or a call of a service, is refused during playback; None if it is not."""
    if path in SERVICES or path in _SERVERS:
        return None
    text = f'playback: this is a recording, so "{path[:200]}" is not available'
    return Fault("denied", f"{text}; the services under playback/ control it", path[:200])
