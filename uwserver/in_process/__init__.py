"""A world for the program that steps it in its own process: what `uwserver.load` gives, recordings as arrays, vehicles, descriptions."""

from __future__ import annotations

from uwserver.in_process.serving import Serving
from uwserver.in_process.traces import Trace, Traces
from uwserver.in_process.vehicles import Pose, Vehicle, Velocity
from uwserver.in_process.world import World

__all__ = ["Pose", "Serving", "Trace", "Traces", "Vehicle", "Velocity", "World"]
