"""The base of all tasks of a pilot's training, and the tasks at one place: inside a box, at a depth, through a gate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

from msgspec import Meta

from uwserver.frames import Vec3
from uwserver.physics.rays.raycast import Geometry, OpenWater
from uwserver.sensors.others import Outline
from uwserver.table import NonNegative, Positive, Table, Vector3
from uwserver.units import rad

Extent = Annotated[float, Meta(gt=0.0, le=1e4)]
"""Length of an edge or a distance, m."""
Points = Annotated[float, Meta(ge=0, le=1e6)]
"""Points to gain or lose. They are bounded, so that sums stay finite."""


class Eye(NamedTuple):
    """The camera through which a pilot looks.

    Attributes:
        p: position, m in N.
        axis: viewing direction, a unit vector in N.
        cosine: cosine of half the angle of the cone in which it sees well.
    """

    p: Vec3 = (0.0, 0.0, 0.0)
    axis: Vec3 = (1.0, 0.0, 0.0)
    cosine: float = 0.0

    def has_in_view(self, q: Sequence[float]) -> bool:
        """Return whether a point of N (m) is in the cone."""
        away = math.dist(q, self.p)
        ahead = sum(u * (b - a) for u, a, b in zip(self.axis, self.p, q, strict=True))
        return away == 0.0 or ahead >= self.cosine * away


class Moment(NamedTuple):
    """The truth of one instant, by which a task is judged.

    Attributes:
        before: position of the vehicle at the last reading, m in N.
        p: present position, m in N.
        eye: the pilot's camera.
        speed: speed over ground, m/s.
        turning: magnitude of the angular rate, rad/s.
        geometry: the solid things.
        outlines: outlines of structures, by name.
    """

    before: Vec3
    p: Vec3
    eye: Eye = Eye()
    speed: float = 0.0
    turning: float = 0.0
    geometry: Geometry = OpenWater()
    outlines: Mapping[str, Outline] = {}


class Verdict(NamedTuple):
    """The state of a task.

    Attributes:
        piece: number of the piece of the task that is met now; -1 for none.
        goal: the place to go to or to look at, m in N.
        hint: what the pilot should do or change now.
    """

    piece: int
    goal: Vec3
    hint: str = ""


class Task(Table, tag_field="kind", kw_only=True, frozen=True):
    """A task of a pilot. By default it has one piece. A piece is done when it has been met for some time.

    Attributes:
        points: points that it is worth.
        for_s: time for which it has to be met without a break.
        text: text for the pilot; default: the name of the task.
    """

    points: Points = 100.0
    for_s: NonNegative = 0.0
    text: Annotated[str, Meta(max_length=200)] = ""

    def worth(self) -> tuple[float, ...]:
        """Return the points of each piece."""
        return (self.points,)

    def names(self) -> tuple[str, ...]:
        """Return the name of each piece; "" for a piece without a name."""
        return ("",)

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Return the state of the task. done: which pieces are done; piece: the one that was met at the last reading, -1 for none."""
        raise NotImplementedError

    def is_over(self, done: Sequence[bool]) -> bool:
        """Return whether the next task follows."""
        return all(done)

    def part(self, done: Sequence[bool]) -> float:
        """Return how much of the task is done, 0 to 1."""
        return sum(done) / len(done)

    def has_marks(self) -> bool:
        """Return whether there is something to mark."""
        return False

    def marked(self, moment: Moment, done: Sequence[bool]) -> int:
        """Return the piece that a mark at this moment completes; -1 for none. It may be done already."""
        return -1


class Reach(Task, tag="reach", kw_only=True, frozen=True):
    """Be inside a box.

    Attributes:
        position_ned_m: its centre.
        size_m: lengths of its edges north, east and down.
    """

    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    size_m: tuple[Extent, Extent, Extent] = (2.0, 2.0, 2.0)

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Return that it is met inside the box."""
        edges = zip(moment.p, self.position_ned_m, self.size_m, strict=True)
        is_met = all(abs(own - middle) <= 0.5 * size for own, middle, size in edges)
        return Verdict(0 if is_met else -1, self.position_ned_m)


class HoldDepth(Task, tag="hold_depth", kw_only=True, frozen=True):
    """Keep a depth for the time `for_s`.

    Attributes:
        depth_m, tolerance_m: the depth to keep, and the largest deviation.
    """

    depth_m: float = 0.0
    tolerance_m: Positive = 0.25

    def __post_init__(self) -> None:
        """Raise ValueError without a duration: the task would be done at once."""
        if self.for_s == 0.0:
            raise ValueError("hold_depth needs for_s: how long the depth has to be kept")

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Return that it is met near the depth. The goal is straight above or below the vehicle."""
        north, east, down = moment.p
        is_met = abs(down - self.depth_m) <= self.tolerance_m
        return Verdict(0 if is_met else -1, (north, east, self.depth_m))


class Gate(Task, tag="gate", kw_only=True, frozen=True):
    """Go through an opening, in its direction.

    Attributes:
        position_ned_m: its centre.
        size_m: the second number is its width, the third its height.
        heading_deg: direction in which to go through it.
    """

    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    size_m: tuple[Extent, Extent, Extent] = (2.0, 2.0, 2.0)
    heading_deg: float = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError for a gate with a duration."""
        if self.for_s > 0.0:
            raise ValueError("a gate is passed at once: remove for_s")

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Return that it is met if the straight line since the last reading passes through the opening."""
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
