"""Degrees of tables and nanoseconds of samples, as the modules beside this one need them."""

from __future__ import annotations

from uwserver.units import NANOSECONDS, rad


def radians(degrees: float) -> float:
    """Of an angle in a table."""
    return rad(degrees)


def seconds(t_ns: int) -> float:
    """Of a simulation time."""
    return t_ns / NANOSECONDS


def nanoseconds(t_s: float) -> int:
    """Of a simulation time."""
    return round(t_s * NANOSECONDS)
