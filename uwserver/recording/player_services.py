"""What can be asked of a recording that is played, and why nothing else can."""

from __future__ import annotations

from uwserver.ports import Argument, Fault, Service
from uwserver.simulation.services import CLOCK_SERVICES

DEFAULT = -1
"""Of arguments that say: as it is."""
_T = "simulation time of the recording"
PLAYBACK_SERVICES = (
    Service("playback/pause", "Stop time, as world/pause."),
    Service("playback/resume", "Let time run on, as world/resume; from the end it begins anew."),
    Service(
        "playback/seek",
        "Go to a time: an event reset is told, and each port gives its last sample before it.",
        (
            Argument("t_s", "float", _T, "s", minimum=0.0, maximum=1e9),
            Argument("run", "int", "which run between resets; default: the present", required=False, default=DEFAULT, minimum=-1, maximum=1e9),
        ),
    ),
    Service(
        "playback/speed",
        "Simulated seconds per second of the wall clock.",
        (Argument("speed", "float", "factor; 0 for as fast as possible", minimum=0.0, maximum=1000.0),),
    ),
    Service(
        "playback/loop",
        "Play a range again and again, or once.",
        (
            Argument("on", "bool", "false: stop at its end", required=False, default=True),
            Argument("from_s", "float", "its begin; default: as before", "s", required=False, default=float(DEFAULT), minimum=-1.0, maximum=1e9),
            Argument("to_s", "float", "its end; default: as before", "s", required=False, default=float(DEFAULT), minimum=-1.0, maximum=1e9),
        ),
    ),
    Service(
        "playback/step",
        "Go on by n ticks and pause there; by a negative number back, which is a seek.",
        (Argument("n", "int", "ticks", required=False, default=1, minimum=-1e9, maximum=1e9),),
        long_running=True,
    ),
    Service("playback/state", "File, time, range, speed, runs, and the events of the file as marks.", reads_only=True),
)  # fmt: skip
SERVICES = {service.path: service for service in (*CLOCK_SERVICES, *PLAYBACK_SERVICES)}
"""All that steers the time of a recording."""

_SERVERS = frozenset(("world/describe", "world/status", "world/shutdown"))


def objection(path: str) -> Fault | None:
    """Why a command to a port, or the call of a service, makes no sense while a recording is played; None where it does."""
    if path in SERVICES or path in _SERVERS:
        return None
    text = f'playback: this is a recording, in which "{path[:200]}" can change nothing and be asked nothing'
    return Fault("denied", f"{text}; what steers it is under playback/", path[:200])
