"""Constants and the one place where degrees meet radians.

Inside uwserver everything is SI, radians and integer nanoseconds. Degrees exist only in files (converted by the scenario loader) and on
wires that want them (converted by a codec); both use this module.
"""

from __future__ import annotations

import math

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""

STANDARD_ATMOSPHERE_PA = 101_325.0
"""Pressure at the sea surface, Pa (ISO 2533)."""


def rad(degrees: float) -> float:
    """Degrees to radians."""
    return math.radians(degrees)


def deg(radians: float) -> float:
    """Radians to degrees."""
    return math.degrees(radians)
