"""What a delivered sample tells, as numbers that an estimate can be corrected by."""

from __future__ import annotations

from uwserver.frames import Quat, Vec3
from uwserver.ports import Value


class Unusable(Exception):
    """A valid sample that no sensor gives: one on its way may come from a saved state."""


def number(value: Value) -> float:
    """A float below 1e9.

    Raises:
        Unusable: it is none.
    """
    if not isinstance(value, float) or not abs(value) < 1e9:
        raise Unusable
    return value


def vector(value: Value) -> Vec3:
    """Three numbers, all below 1e9; raises as `number`."""
    try:
        x, y, z = value  # type: ignore[misc,str-unpack]  # what is none is found out here
        usable = abs(x) + abs(y) + abs(z) < 1e9  # type: ignore[arg-type]
    except (TypeError, ValueError):
        usable = False
    if not usable:
        raise Unusable
    return value  # type: ignore[return-value]


def quaternion(value: Value) -> Quat:
    """Four numbers of length about one; raises as `number`."""
    try:
        a, b, c, d = value  # type: ignore[misc,str-unpack]
        usable = 0.9 < a * a + b * b + c * c + d * d < 1.1  # type: ignore[operator]
    except (TypeError, ValueError):
        usable = False
    if not usable:
        raise Unusable
    return value  # type: ignore[return-value]
