"""Tasks of a pilot's training that are met at one place: in a box, at a depth, through a gate. And what all tasks have in common."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

from msgspec import Meta

from uwserver.frames import Vec3
from uwserver.physics.rays.raycast import Geometry, OpenWater
from uwserver.sensors.place import Outline
from uwserver.table import NonNegative, Positive, Table, Vector3
from uwserver.units import rad

Extent = Annotated[float, Meta(gt=0.0, le=1e4)]
"""Of something, m."""
Points = Annotated[float, Meta(ge=0, le=1e6)]
"""That something is worth or costs: bounded, so that sums of them are numbers."""


class Eye(NamedTuple):
    """The camera through which a pilot looks.

    Attributes:
        p: where it is, m in N.
        axis: where it looks, a unit vector in N.
        cosine: of half of the cone in which it sees well.
    """

    p: Vec3 = (0.0, 0.0, 0.0)
    axis: Vec3 = (1.0, 0.0, 0.0)
    cosine: float = 0.0

    def has_in_view(self, q: Sequence[float]) -> bool:
        """Whether a point of N (m) is in the cone."""
        away = math.dist(q, self.p)
        ahead = sum(u * (b - a) for u, a, b in zip(self.axis, self.p, q, strict=True))
        return away == 0.0 or ahead >= self.cosine * away


class Moment(NamedTuple):
    """What a task is judged by: the truth of one instant.

    Attributes:
        before: where the vehicle was at the last reading, m in N.
        p: where it is.
        eye: the pilot's camera.
        speed: over ground, m/s.
        turning: rad/s.
        geometry: solid things.
        outlines: of structures by name.
    """

    before: Vec3
    p: Vec3
    eye: Eye = Eye()
    speed: float = 0.0
    turning: float = 0.0
    geometry: Geometry = OpenWater()
    outlines: Mapping[str, Outline] = {}


class Verdict(NamedTuple):
    """How a task stands.

    Attributes:
        piece: number of the piece of it that is met now; -1 for none.
        goal: where the pilot is to go or to look, m in N.
        hint: what is to be done, or done otherwise, now.
    """

    piece: int
    goal: Vec3
    hint: str = ""


class Task(Table, tag_field="kind", kw_only=True, frozen=True):
    """One task of a pilot: of one piece, unless it says more, that is done when it has been met for some time.

    Attributes:
        points: what it is worth.
        for_s: how long without a break it has to be met.
        text: what the pilot is told; default: the task's name.
    """

    points: Points = 100.0
    for_s: NonNegative = 0.0
    text: Annotated[str, Meta(max_length=200)] = ""

    def worth(self) -> tuple[float, ...]:
        """Points of each piece."""
        return (self.points,)

    def names(self) -> tuple[str, ...]:
        """Of each piece; empty where it has none."""
        return ("",)

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """How it stands; `done` says which pieces are, and `piece` is the one that was met at the last reading, -1 for none."""
        raise NotImplementedError

    def is_over(self, done: Sequence[bool]) -> bool:
        """Whether the next task follows."""
        return all(done)

    def part(self, done: Sequence[bool]) -> float:
        """How much of it is done, 0 to 1."""
        return sum(done) / len(done)

    def has_marks(self) -> bool:
        """Whether the pilot is to mark something."""
        return False

    def marked(self, moment: Moment, done: Sequence[bool]) -> int:
        """The piece that is done by a mark here, which may be done already; -1 for none."""
        return -1


class Reach(Task, tag="reach", kw_only=True, frozen=True):
    """Be inside a box.

    Attributes:
        position_ned_m: its middle.
        size_m: whole edges, north, east, down.
    """

    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    size_m: tuple[Extent, Extent, Extent] = (2.0, 2.0, 2.0)

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Met inside."""
        edges = zip(moment.p, self.position_ned_m, self.size_m, strict=True)
        is_met = all(abs(own - middle) <= 0.5 * size for own, middle, size in edges)
        return Verdict(0 if is_met else -1, self.position_ned_m)


class HoldDepth(Task, tag="hold_depth", kw_only=True, frozen=True):
    """Keep a depth for `for_s`.

    Attributes:
        depth_m, tolerance_m: to keep, and how far off it may be.
    """

    depth_m: float = 0.0
    tolerance_m: Positive = 0.25

    def __post_init__(self) -> None:
        """ValueError where it would be done at once."""
        if self.for_s == 0.0:
            raise ValueError("hold_depth needs for_s: for how long the depth is kept")

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Met near the depth, which is above or below the vehicle."""
        north, east, down = moment.p
        is_met = abs(down - self.depth_m) <= self.tolerance_m
        return Verdict(0 if is_met else -1, (north, east, self.depth_m))


class Gate(Task, tag="gate", kw_only=True, frozen=True):
    """Go through an opening, the way it points.

    Attributes:
        position_ned_m: its middle.
        size_m: the second is its width and the third its height.
        heading_deg: way through it.
    """

    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    size_m: tuple[Extent, Extent, Extent] = (2.0, 2.0, 2.0)
    heading_deg: float = 0.0

    def __post_init__(self) -> None:
        """ValueError where a gate would have to be passed for some time."""
        if self.for_s > 0.0:
            raise ValueError("a gate is passed at once: remove for_s")

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Met at the reading after it was passed in a straight line."""
        return Verdict(0 if self._is_passed(moment.before, moment.p) else -1, self.position_ned_m)

    def _is_passed(self, before: Vec3, p: Vec3) -> bool:
        c, s = math.cos(rad(self.heading_deg)), math.sin(rad(self.heading_deg))
        (n0, e0, d0), (n1, e1, d1) = (
            (q[0] - self.position_ned_m[0], q[1] - self.position_ned_m[1], q[2] - self.position_ned_m[2])
            for q in (before, p)
        )
        ahead0, ahead1 = c * n0 + s * e0, c * n1 + s * e1
        if not ahead0 < 0.0 <= ahead1:
            return False
        part = ahead0 / (ahead0 - ahead1)
        across = (c * e0 - s * n0) + part * ((c * e1 - s * n1) - (c * e0 - s * n0))
        down = d0 + part * (d1 - d0)
        return abs(across) <= 0.5 * self.size_m[1] and abs(down) <= 0.5 * self.size_m[2]
