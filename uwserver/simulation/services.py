"""The services of the clock, which the simulation thread carries out between two ticks."""

from __future__ import annotations

from uwserver.ports import Argument, Service

CLOCK_SERVICES = (
    Service("world/pause", "Stop time. Calls are still answered."),
    Service("world/resume", "Let time run on."),
    Service(
        "world/step",
        "Paused: run n ticks as fast as possible, then reply. Lockstep: grant n ticks for this client, reply when they are done.",
        (Argument("n", "int", "ticks", required=False, default=1, minimum=1, maximum=1e9),),
        long_running=True,
    ),
    Service(
        "world/run_until",
        "Reply in the first tick whose time is t_s or later (or 1 ns earlier, for floats); a paused world runs until then and is paused again.",
        (Argument("t_s", "float", "simulation time", "s", minimum=0.0, maximum=1e9),),
        long_running=True,
    ),
    Service(
        "world/run_until_tick",
        "Reply when the world stands at this tick; a paused world runs until then and is paused again.",
        (Argument("tick", "int", "number of the tick", minimum=0, maximum=1e15),),
        long_running=True,
    ),
    Service(
        "world/set_speed",
        "Simulated seconds per second of the wall clock (mode realtime).",
        (Argument("speed", "float", "speed factor", minimum=1e-3, maximum=1000.0),),
    ),
)
