"""The head of a sonar that turns in steps: about the sensor's z, from x towards y, to and fro in a sector or on and on."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Protocol

import numpy as np
from msgspec import Meta

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Argument

Step = Annotated[float, Meta(ge=1e-6, le=1)]
SectorCenter = Annotated[float, Meta(ge=-1e6, le=1e6)]
SectorWidth = Annotated[float, Meta(ge=0, le=7)]
"""Settings, rad."""
Index = Annotated[int, Meta(ge=0)]
Sense = Literal[-1, 1]
"""What is remembered: the number of the step, and whether the head turns back (-1) or on (1)."""


class Sector(Protocol):
    """Settings of a head, rad."""

    @property
    def step(self) -> float:
        """From ping to ping."""

    @property
    def sector_center(self) -> float:
        """Middle of the sector."""

    @property
    def sector_width(self) -> float:
        """2 pi for continuous rotation, 0 for a head that stands still."""


class Head(Protocol):
    """Where it is."""

    index: Index
    sense: Sense


def step_on(sector: Sector, head: Head) -> float:
    """Angle of this ping (rad); the head moves on to the next."""
    whole = sector.sector_width > 2.0 * math.pi - 1e-9
    count = max(1, round(sector.sector_width / sector.step) + (0 if whole else 1))
    index = min(head.index, count - 1)
    first = sector.sector_center - (0.0 if whole else 0.5 * (count - 1) * sector.step)
    if whole:
        head.index = (index + 1) % count
    else:
        head.sense = -1 if index >= count - 1 else 1 if index <= 0 else head.sense
        head.index = min(max(index + head.sense, 0), count - 1)
    return math.remainder(first + index * sector.step, 2.0 * math.pi)


def turned(angle: float) -> FloatArray:
    """(3, 3) whose columns are the axes of a head at this angle, in the frame of the sensor."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


def head_arguments(least_width: float) -> tuple[Argument, ...]:
    """Of the service ``set``; `least_width` of the sector, rad."""
    pi, whole = math.pi, 2.0 * math.pi + 1e-9
    return (
        Argument("step", "float", "angle from ping to ping", "rad", False, minimum=1e-3, maximum=0.6),
        Argument("sector_center", "float", "middle of the sector", "rad", False, minimum=-pi, maximum=pi),
        Argument(
            "sector_width", "float", "what the head covers; 2 pi for continuous rotation", "rad", False, minimum=least_width, maximum=whole
        ),
    )  # fmt: skip
