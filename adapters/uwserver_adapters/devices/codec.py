"""Units in which devices speak: degrees on the wire, radians inside."""

from __future__ import annotations

import math

from uwserver.units import NANOSECONDS, deg, rad

FULL_TURN_DEG = deg(2.0 * math.pi)

__all__ = ["FULL_TURN_DEG", "NANOSECONDS", "deg", "rad"]
