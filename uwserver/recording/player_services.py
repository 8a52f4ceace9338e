"""The services of playback, and the reason why all others are refused."""

from __future__ import annotations

from uwserver.ports import Argument, Fault, Service
from uwserver.simulation.services import CLOCK_SERVICES

DEFAULT = -1
"""Value of an argument that leaves a setting as it is."""
_T = "simulation time of the recording"
PLAYBACK_SERVICES = (
    Service("playback/pause", "Pause, like world/pause."),
    Service("playback/resume", "Resume, like world/resume; at the end of the recording playback begins again."),
    Service(
        "playback/seek",
        "Go to a time. An event reset announces it, and each port gives its last sample before that time.",
        (
            Argument("t_s", "float", _T, "s", minimum=0.0, maximum=1e9),
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

_SERVERS = frozenset(("world/describe", "world/status", "world/shutdown"))


def objection(path: str) -> Fault | None:
    """Return why a command to a port, or a call of a service, is refused during playback; None if it is not."""
    if path in SERVICES or path in _SERVERS:
        return None
    text = f'playback: this is a recording, so "{path[:200]}" is not available'
    return Fault("denied", f"{text}; the services under playback/ control it", path[:200])
