"""Constants, and the conversion between degrees and radians.

Inside uwserver everything is SI, radians and integer nanoseconds. Degrees exist only in files (the scenario loader converts them) and on wires that
use them (a codec converts them); both use this module.
"""

from __future__ import annotations

import math

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""

STANDARD_ATMOSPHERE_PA = 101_325.0
"""Pressure at the sea surface, Pa (ISO 2533)."""


def rad(degrees: float) -> float:
    """Convert degrees to radians."""
    return math.radians(degrees)


def deg(radians: float) -> float:
    """Convert radians to degrees."""
    return math.degrees(radians)
