"""The tasks of a pilot's training: their base, those at one place (inside a box, at a depth, through a gate), and those that need the camera."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta, field

from uwserver.frames import Vec3, conjugate, rotate
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import Geometry, OpenWater
from uwserver.sensors.base import Outline
from uwserver.table import Name, NonNegative, Positive, Table, Vector3
from uwserver.units import rad

Extent = Annotated[float, Meta(gt=0.0, le=1e4)]
"""Length of an edge or a distance, m."""
Points = Annotated[float, Meta(ge=0, le=1e6)]
"""Points to gain or lose. They are bounded, so that sums stay finite."""
_MOST_METRES = 2000
_TOLERANCE_M = 0.03
"""A ray that ends this near to the box around a structure has hit the structure."""
_AHEAD_M = 4.0
"""Length of the pipe ahead of which the pilot has to see some part."""
_LEAD_M = 3.0
"""The goal on the pipe is this far ahead of the vehicle."""
_SAMPLES = (
    (0.0, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, -0.5, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, -0.5), (0.0, 0.0, 0.5),
)  # fmt: skip
"""Points of the box around a structure at which rays are aimed, in halves of its edges."""
_MET = 5


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


Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]


def is_hidden(eye: Vec3, outline: Outline, geometry: Geometry) -> bool:
    """Return whether solid things hide more than half of a structure from a point of N (m)."""
    start = np.array(eye)
    offsets = [rotate(outline.q, [part * half for part, half in zip(s, outline.half, strict=True)]) for s in _SAMPLES]
    ways = np.array(outline.p) + np.array(offsets) - start
    reach = np.linalg.norm(ways, axis=1)
    if not bool((reach > 0.0).all()):
        return False
    ways /= reach[:, None]
    distance = geometry.raycast(np.tile(start, (len(ways), 1)), ways, float(reach.max())).distance
    to_box = conjugate(outline.q)
    met = 0
    for way, away in zip(ways, distance.tolist(), strict=True):
        if math.isfinite(away):
            x = rotate(to_box, (start + away * way - outline.p).tolist())
            met += all(abs(own) <= half + _TOLERANCE_M for own, half in zip(x, outline.half, strict=True))
    return 2 * met <= len(_SAMPLES)


class Inspect(Task, tag="inspect", kw_only=True, frozen=True):
    """Inspect some structures in any order: from a good distance, with the camera on the structure, and still. Each is worth its part of the points.

    Attributes:
        structures: names of structures of the scenario.
        distance_m: smallest and largest distance of the camera from the centre of a structure.
        max_speed_mps, max_turn_degps: largest speed over ground and angular rate during the inspection.
    """

    for_s: NonNegative = 3.0
    structures: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=100)]
    distance_m: tuple[NonNegative, Positive] = (0.5, 2.5)
    max_speed_mps: Positive = 0.15
    max_turn_degps: Positive = 10.0

    def __post_init__(self) -> None:
        """Raise ValueError if the range of distances is empty, or if a structure is named twice."""
        if self.distance_m[0] >= self.distance_m[1]:
            raise ValueError(
                f"distance_m: {self.distance_m[0]:g} m at least is not less than {self.distance_m[1]:g} m at most"
            )
        twice = next((name for name in self.structures if self.structures.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f'structures: "{twice}" is named twice')

    def worth(self) -> tuple[float, ...]:
        """Return the points of each structure."""
        return (self.points / len(self.structures),) * len(self.structures)

    def names(self) -> tuple[str, ...]:
        """Return the names of the structures."""
        return self.structures

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Return the structure that is inspected now. Otherwise return what is missing, for the structure that is closest to being inspected."""
        best: tuple[int, float, int, Outline, str] | None = None
        for k, name in enumerate(self.structures):
            outline = moment.outlines.get(name)
            if outline is None or done[k]:
                continue
            grade, hint = self._grade_of(moment, outline)
            away = -1.0 if k == piece else math.dist(moment.eye.p, outline.p)  # prefer the one of the last reading
            if best is None or (-grade, away) < (-best[0], best[1]):
                best = grade, away, k, outline, hint
        if best is None:
            return Verdict(-1, moment.p)
        grade, _, k, outline, hint = best
        return Verdict(k if grade == _MET else -1, outline.p, hint)

    def _grade_of(self, moment: Moment, outline: Outline) -> tuple[int, str]:
        """Return how many conditions are met, and a hint for the first that is not."""
        low, high = self.distance_m
        away = math.dist(moment.eye.p, outline.p)
        if away > high:
            return 0, "go nearer"
        if away < low:
            return 1, "too near: back off"
        if not moment.eye.has_in_view(outline.p):
            return 2, "turn the camera to it"
        if is_hidden(moment.eye.p, outline, moment.geometry):
            return 3, "it is hidden: go round"
        if moment.speed > self.max_speed_mps or moment.turning > rad(self.max_turn_degps):
            return 4, "hold still"
        return _MET, "keep looking"


class Finding(Table, kw_only=True, frozen=True):
    """Something along the path that the pilot has to mark.

    Attributes:
        position_ned_m: its position.
        within_m: largest distance of the camera when it is marked.
        points: points that it is worth.
    """

    position_ned_m: Vector3
    within_m: Extent = 4.0
    points: Points = 50.0


class Along(NamedTuple):
    """The point of a path that is nearest to a given point.

    Attributes:
        s: distance from the start along the horizontal projection of the path, m.
        p: the point, m in N.
        aside: horizontal distance from the given point, m.
    """

    s: float
    p: Vec3
    aside: float


class Legs(NamedTuple):
    """The straight legs of a path, without those that are vertical.

    Attributes:
        start, along: (n, 3) start of each leg, and the vector to its end, m in N.
        square: (n,) square of its horizontal length, m^2.
        before: (n + 1,) horizontal length of all legs before each one, and of the whole path, m.
    """

    start: FloatArray
    along: FloatArray
    square: FloatArray
    before: FloatArray

    def place(self, k: int, part: float) -> Vec3:
        """Return the point at this part of leg k."""
        north, east, down = (self.start[k] + part * self.along[k]).tolist()
        return north, east, down


class Follow(Task, tag="follow", kw_only=True, frozen=True, dict=True):
    """Follow a pipe or a cable inside a corridor around it, with the camera on it, and mark findings. Each metre is worth its part of the points.

    Attributes:
        points: points of the whole path; findings have their own.
        path_ned_m: points along its axis, in the direction to follow. The path must not come near itself again.
        aside_m: largest horizontal distance from the axis.
        height_m: smallest and largest height of the vehicle above the axis; negative means below it.
        max_speed_mps: largest speed over ground; a faster pilot would overlook something.
        findings: by name, the things to mark: the pilot calls `set` with `mark` = true while the camera has one in view.
        wrong_mark_points: points that a mark without a finding costs.
    """

    path_ned_m: Annotated[tuple[tuple[Metres, Metres, Metres], ...], Meta(min_length=2, max_length=1000)]
    aside_m: Extent = 1.0
    height_m: tuple[Metres, Metres] = (0.4, 2.5)
    max_speed_mps: Positive = 1.0
    findings: dict[str, Finding] = field(default_factory=dict)
    wrong_mark_points: Points = 20.0

    def __post_init__(self) -> None:
        """Raise ValueError if the path cannot be followed."""
        if self.for_s > 0.0:
            raise ValueError("metres are followed, not held: remove for_s")
        if self.height_m[0] >= self.height_m[1]:
            raise ValueError(
                f"height_m: {self.height_m[0]:g} m at least is not less than {self.height_m[1]:g} m at most"
            )
        if not 1.0 <= self.length <= _MOST_METRES:
            raise ValueError(
                f"path_ned_m: its horizontal length is {self.length:.1f} m; it has to be 1 to {_MOST_METRES} m"
            )

    @cached_property
    def length(self) -> float:
        """Horizontal length of the path, m."""
        return math.fsum(math.dist(a[:2], b[:2]) for a, b in pairwise(self.path_ned_m))

    @cached_property
    def _legs(self) -> Legs:
        """The legs of the path. They are computed once, because a task is judged many times a second."""
        path = np.array(self.path_ned_m, dtype=np.float64)
        along = np.diff(path, axis=0)
        square = np.sum(along[:, :2] ** 2, axis=1)
        on = square > 0.0  # a vertical leg has no horizontal length
        return Legs(path[:-1][on], along[on], square[on], np.concatenate([[0.0], np.cumsum(np.sqrt(square[on]))]))

    @property
    def metres(self) -> int:
        """Number of pieces of the path. Each is a metre long; the last is a little longer."""
        return max(1, int(self.length))

    def worth(self) -> tuple[float, ...]:
        """Return the points of each metre and of each finding."""
        return (self.points / self.metres,) * self.metres + tuple(f.points for f in self.findings.values())

    def names(self) -> tuple[str, ...]:
        """Return the names of the findings; a metre has no name."""
        return ("",) * self.metres + tuple(self.findings)

    def is_over(self, done: Sequence[bool]) -> bool:
        """Return whether the last metre is done. Metres that were left out give no points."""
        return done[self.metres - 1]

    def part(self, done: Sequence[bool]) -> float:
        """Return the part of the metres that is done."""
        return sum(done[: self.metres]) / self.metres

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Return the metre above which the vehicle is, if it is inside the corridor."""
        here = self.nearest(moment.p)
        fly, height = self._above(self.at(min(here.s + _LEAD_M, self.length))), here.p[2] - moment.p[2]
        if here.aside > self.aside_m and any(done):
            return Verdict(-1, self._above(here.p), "too far to the side")
        if here.aside > self.aside_m:
            return Verdict(-1, self._above(self.path_ned_m[0]), "go to where it begins")
        if height > self.height_m[1]:
            return Verdict(-1, fly, "too high above it")
        if height < self.height_m[0]:
            return Verdict(-1, fly, "too low")
        if not any(moment.eye.has_in_view(q) for q in self._points_ahead(here.s)):
            return Verdict(-1, fly, "turn the camera to it")
        if moment.speed > self.max_speed_mps:
            return Verdict(-1, fly, "too fast")
        metre = min(int(here.s), self.metres - 1)
        return Verdict(-1 if done[metre] else metre, fly, "follow it")

    def has_marks(self) -> bool:
        """Return whether there are findings."""
        return bool(self.findings)

    def marked(self, moment: Moment, done: Sequence[bool]) -> int:
        """Return the nearest finding that is in view and near enough. One that is not marked yet goes before those that are."""
        found = [
            (done[self.metres + k], math.dist(moment.eye.p, finding.position_ned_m), self.metres + k)
            for k, finding in enumerate(self.findings.values())
            if math.dist(moment.eye.p, finding.position_ned_m) <= finding.within_m
            and moment.eye.has_in_view(finding.position_ned_m)
        ]
        return min(found)[2] if found else -1

    def nearest(self, p: Sequence[float]) -> Along:
        """Return the point of the path that is nearest to a point of N, in the horizontal plane."""
        legs = self._legs
        off = np.array(p[:2]) - legs.start[:, :2]
        part = np.clip(np.sum(off * legs.along[:, :2], axis=1) / legs.square, 0.0, 1.0)
        aside = np.hypot(*(off - part[:, None] * legs.along[:, :2]).T)
        k = int(np.argmin(aside))
        s = legs.before[k] + part[k] * math.sqrt(legs.square[k])
        return Along(float(s), legs.place(k, float(part[k])), float(aside[k]))

    def at(self, s: float) -> Vec3:
        """Return the point at a distance s along the path. Beyond the end, the last leg is extended."""
        legs = self._legs
        k = min(max(int(np.searchsorted(legs.before, s)) - 1, 0), len(legs.square) - 1)
        return legs.place(k, float((s - legs.before[k]) / math.sqrt(legs.square[k])))

    def _above(self, p: Vec3) -> Vec3:
        """Return the middle of the corridor above a point of the path."""
        return (p[0], p[1], p[2] - 0.5 * sum(self.height_m))

    def _points_ahead(self, s: float) -> Iterator[Vec3]:
        return (self.at(s + 0.5 * k) for k in range(int(2 * _AHEAD_M) + 1))


def eye_at(p: Vec3, q: Sequence[float], view_deg: float) -> Eye:
    """Return an eye at a pose in N, which sees well in a cone of this full angle about its x axis."""
    return Eye(p, rotate(q, (1.0, 0.0, 0.0)), math.cos(0.5 * rad(view_deg)))
