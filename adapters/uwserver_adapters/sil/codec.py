"""Degrees of tables and nanoseconds of samples for the adapters of autopilots: the only modules that convert units are named codec."""

from __future__ import annotations

from uwserver.units import NANOSECONDS, rad

radians = rad
"""Degrees of a table to radians."""


def seconds(t_ns: int) -> float:
    """Convert a simulation time to seconds."""
    return t_ns / NANOSECONDS


def nanoseconds(t_s: float) -> int:
    """Convert a simulation time to nanoseconds."""
    return round(t_s * NANOSECONDS)
