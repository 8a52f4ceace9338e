"""The head of a sonar that turns in steps around the sensor's z, from x towards y: to and fro in a sector, or continuously."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from uwserver.frames import Quat
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Argument
from uwserver.sensors.acoustic.pinging import PingMemory, PingSettings
from uwserver.sensors.compiled import rotate

_WHOLE = 2.0 * math.pi


class HeadSettings(PingSettings, frozen=True):
    """Settings of a sonar with a head; angles in rad."""

    step: Annotated[float, Meta(ge=1e-6, le=1)]
    sector_center: Annotated[float, Meta(ge=-1e6, le=1e6)]
    sector_width: Annotated[float, Meta(ge=0, le=7)]


class HeadMemory(PingMemory):
    """Attributes:
    index: step of the head, from 0.
    sense: whether the head turns back (-1) or on (1)."""

    index: Annotated[int, Meta(ge=0)] = 0
    sense: Literal[-1, 1] = 1


@compiled
def step_on(step: float, center: float, width: float, index: int, sense: int) -> tuple[float, int, int]:
    """Turn a head to its next ping.

    Args:
        step: angle from ping to ping, rad.
        center: middle of the sector, rad.
        width: width of the sector, rad; 2 pi for continuous rotation, 0 for a head that stands still.
        index, sense: memory of the head.

    Returns:
        Angle of this ping (rad, -pi to pi), and index and sense for the next one.
    """
    whole = width > _WHOLE - 1e-9
    count = max(1, int(np.rint(width / step)) + (0 if whole else 1))
    at = min(index, count - 1)
    first = center - (0.0 if whole else 0.5 * (count - 1) * step)
    angle = float(np.fmod(first + at * step, _WHOLE))
    if abs(angle) > math.pi:
        angle -= math.copysign(_WHOLE, angle)
    if whole:
        return angle, (at + 1) % count, sense
    sense = -1 if at >= count - 1 else 1 if at <= 0 else sense
    return angle, min(max(at + sense, 0), count - 1), sense


@compiled
def axes(q: Quat, angle: float, R: Array) -> None:
    """Write the axes of a head at an angle (rad) into the columns of R (3, 3), in the frame to which q rotates from the sensor frame."""
    c, s = math.cos(angle), math.sin(angle)
    R[0, 0], R[1, 0], R[2, 0] = rotate(q, (c, s, 0.0))
    R[0, 1], R[1, 1], R[2, 1] = rotate(q, (-s, c, 0.0))
    R[0, 2], R[1, 2], R[2, 2] = rotate(q, (0.0, 0.0, 1.0))


def head_arguments(least_width: float) -> tuple[Argument, ...]:
    """Return the arguments of the service ``set`` for a head; `least_width`: of the sector, rad."""
    pi, whole = math.pi, 2.0 * math.pi + 1e-9
    return (
        Argument("step", "float", "angle from ping to ping", "rad", False, minimum=1e-3, maximum=0.6),
        Argument("sector_center", "float", "middle of the sector", "rad", False, minimum=-pi, maximum=pi),
        Argument(
            "sector_width", "float", "what the head covers; 2 pi for continuous rotation", "rad", False, minimum=least_width, maximum=whole
        ),
    )  # fmt: skip
