"""Tasks of a pilot's training that are done with the camera: look at structures from near by, follow a pipe and mark what is wrong with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta, field

from uwserver.frames import Vec3, conjugate, rotate
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import Geometry
from uwserver.sensors.onboard.tasks import Extent, Eye, Moment, Points, Task, Verdict
from uwserver.sensors.place import Outline
from uwserver.table import Name, NonNegative, Positive, Table, Vector3
from uwserver.units import rad

Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]
_MOST_METRES = 2000
_SKIN_M = 0.03
"""A ray that ends so near to the box around a structure has met it."""
_LOOKOUT_M = 4.0
"""So far ahead along the pipe the pilot has to see some of it."""
_LEAD_M = 3.0
"""So far ahead of the vehicle the next place of the pipe is shown."""
_SAMPLES = (
    (0.0, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, -0.5, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, -0.5), (0.0, 0.0, 0.5),
)  # fmt: skip
"""Where in the box around a structure rays are aimed at, in halves of its edges."""


def is_hidden(eye: Vec3, outline: Outline, geometry: Geometry) -> bool:
    """Whether solid things hide more than half of a structure from a point of N (m)."""
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
            met += all(abs(own) <= half + _SKIN_M for own, half in zip(x, outline.half, strict=True))
    return 2 * met <= len(_SAMPLES)


class Inspect(Task, tag="inspect", kw_only=True, frozen=True):
    """Look at each of some structures, in any order: from a good distance, with the camera on it, and still. Each is worth its part of the points.

    Attributes:
        structures: names of structures of the scenario.
        distance_m: of the camera from the middle of one, at least and at most.
        max_speed_mps, max_turn_degps: over ground, while one looks.
    """

    for_s: NonNegative = 3.0
    structures: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=100)]
    distance_m: tuple[NonNegative, Positive] = (0.5, 2.5)
    max_speed_mps: Positive = 0.15
    max_turn_degps: Positive = 10.0

    def __post_init__(self) -> None:
        """ValueError where nothing could be inspected, or something twice."""
        if self.distance_m[0] >= self.distance_m[1]:
            raise ValueError(f"distance_m: {self.distance_m[0]:g} m at least is not less than {self.distance_m[1]:g} m")
        twice = next((name for name in self.structures if self.structures.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f'structures: "{twice}" is there twice')

    def worth(self) -> tuple[float, ...]:
        """Of each structure."""
        return (self.points / len(self.structures),) * len(self.structures)

    def names(self) -> tuple[str, ...]:
        """Of the structures."""
        return self.structures

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Met by the structure that is looked at well; else what hinders at the one that is nearest to it."""
        best: tuple[int, float, int, Outline, str] | None = None
        for k, name in enumerate(self.structures):
            outline = moment.outlines.get(name)
            if outline is None or done[k]:
                continue
            grade, hint = self._graded(moment, outline)
            away = -1.0 if k == piece else math.dist(moment.eye.p, outline.p)  # one that is looked at stays it
            if best is None or (-grade, away) < (-best[0], best[1]):
                best = grade, away, k, outline, hint
        if best is None:
            return Verdict(-1, moment.p)
        grade, _, k, outline, hint = best
        return Verdict(k if grade == _MET else -1, outline.p, hint)

    def _graded(self, moment: Moment, outline: Outline) -> tuple[int, str]:
        """How much of what is wanted is there, and what is missing first."""
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


_MET = 5


class Finding(Table, kw_only=True, frozen=True):
    """Something on the way that the pilot has to mark.

    Attributes:
        position_ned_m: where it is.
        within_m: how near the camera has to be to mark it.
        points: what it is worth.
    """

    position_ned_m: Vector3
    within_m: Extent = 4.0
    points: Points = 50.0


class Along(NamedTuple):
    """The place of a line that is nearest to a point.

    Attributes:
        s: from its begin along its horizontal projection, m.
        p: the place, N.
        aside: horizontal distance from the point, m.
    """

    s: float
    p: Vec3
    aside: float


class Legs(NamedTuple):
    """The straight pieces of a way that lead on, as seen from above.

    Attributes:
        start, along: (n, 3) where each begins, and the way to its end, m in N.
        square: (n,) of its length as seen from above, m^2.
        before: (n + 1,) such lengths of all before it together, and of all, m.
    """

    start: FloatArray
    along: FloatArray
    square: FloatArray
    before: FloatArray

    def place(self, k: int, part: float) -> Vec3:
        """On the k-th of them, this part of the way along it."""
        north, east, down = (self.start[k] + part * self.along[k]).tolist()
        return north, east, down


class Follow(Task, tag="follow", kw_only=True, frozen=True, dict=True):
    """Follow a pipe or a cable in a corridor about it with the camera on it: each metre is worth its part of the points; and mark findings.

    Attributes:
        points: of the whole way; findings are worth their own.
        path_ned_m: along its axis, in the direction in which it is followed. It must not come near itself again.
        aside_m: horizontal distance that still counts.
        height_m: of the vehicle above the axis, at least and at most; negative is below it.
        max_speed_mps: over ground; who is faster overlooks something.
        findings: by name: what `set` with `mark` = true has to be called at, while the camera has it in view.
        wrong_mark_points: what a mark costs where nothing is.
    """

    path_ned_m: Annotated[tuple[tuple[Metres, Metres, Metres], ...], Meta(min_length=2, max_length=1000)]
    aside_m: Extent = 1.0
    height_m: tuple[Metres, Metres] = (0.4, 2.5)
    max_speed_mps: Positive = 1.0
    findings: dict[str, Finding] = field(default_factory=dict)
    wrong_mark_points: Points = 20.0

    def __post_init__(self) -> None:
        """ValueError where there is no way, or none that can be followed."""
        if self.for_s > 0.0:
            raise ValueError("metres are followed, not held: remove for_s")
        if self.height_m[0] >= self.height_m[1]:
            raise ValueError(f"height_m: {self.height_m[0]:g} m at least is not less than {self.height_m[1]:g} m")
        if not 1.0 <= self.length <= _MOST_METRES:
            raise ValueError(f"path_ned_m: {self.length:.1f} m long, from above; 1 to {_MOST_METRES} m can be followed")

    @cached_property
    def length(self) -> float:
        """Of the way as seen from above, m."""
        return math.fsum(math.dist(a[:2], b[:2]) for a, b in pairwise(self.path_ned_m))

    @cached_property
    def _legs(self) -> Legs:
        """Of the way, worked out once: a task is judged many times a second."""
        path = np.array(self.path_ned_m, dtype=np.float64)
        along = np.diff(path, axis=0)
        square = np.sum(along[:, :2] ** 2, axis=1)
        on = square > 0.0  # straight down there is no way, as seen from above
        return Legs(path[:-1][on], along[on], square[on], np.concatenate([[0.0], np.cumsum(np.sqrt(square[on]))]))

    @property
    def metres(self) -> int:
        """Pieces of the way: of a metre each, the last one of a little more."""
        return max(1, int(self.length))

    def worth(self) -> tuple[float, ...]:
        """Of each metre, and of each finding."""
        return (self.points / self.metres,) * self.metres + tuple(f.points for f in self.findings.values())

    def names(self) -> tuple[str, ...]:
        """Of the findings; a metre has none."""
        return ("",) * self.metres + tuple(self.findings)

    def is_over(self, done: Sequence[bool]) -> bool:
        """At the end of the way; what was left out on it costs its points."""
        return done[self.metres - 1]

    def part(self, done: Sequence[bool]) -> float:
        """Of the metres."""
        return sum(done[: self.metres]) / self.metres

    def judge(self, moment: Moment, done: Sequence[bool], piece: int) -> Verdict:
        """Met by the metre above which the vehicle is, inside the corridor."""
        here = self.nearest(moment.p)
        ahead = self.at(min(here.s + _LEAD_M, self.length))
        fly = (ahead[0], ahead[1], ahead[2] - 0.5 * sum(self.height_m))
        height = here.p[2] - moment.p[2]
        if here.aside > self.aside_m:
            back = (here.p[0], here.p[1], here.p[2] - 0.5 * sum(self.height_m))
            return Verdict(
                -1,
                back if any(done) else self._begin(),
                "too far to the side" if any(done) else "go to where it begins",
            )
        if height > self.height_m[1]:
            return Verdict(-1, fly, "too high above it")
        if height < self.height_m[0]:
            return Verdict(-1, fly, "too low")
        if not any(moment.eye.has_in_view(q) for q in self._lookout(here.s)):
            return Verdict(-1, fly, "turn the camera to it")
        if moment.speed > self.max_speed_mps:
            return Verdict(-1, fly, "too fast")
        metre = min(int(here.s), self.metres - 1)
        return Verdict(-1 if done[metre] else metre, fly, "follow it")

    def has_marks(self) -> bool:
        """Where there are findings."""
        return bool(self.findings)

    def marked(self, moment: Moment, done: Sequence[bool]) -> int:
        """The finding that is in view and near enough; of more the nearest that is not marked yet, else the nearest."""
        found = [
            (done[self.metres + k], math.dist(moment.eye.p, finding.position_ned_m), self.metres + k)
            for k, finding in enumerate(self.findings.values())
            if math.dist(moment.eye.p, finding.position_ned_m) <= finding.within_m
            and moment.eye.has_in_view(finding.position_ned_m)
        ]
        return min(found)[2] if found else -1

    def nearest(self, p: Sequence[float]) -> Along:
        """The place of the way nearest to a point of N, seen from above."""
        legs = self._legs
        off = np.array(p[:2]) - legs.start[:, :2]
        part = np.clip(np.sum(off * legs.along[:, :2], axis=1) / legs.square, 0.0, 1.0)
        aside = np.hypot(*(off - part[:, None] * legs.along[:, :2]).T)
        k = int(np.argmin(aside))
        s = legs.before[k] + part[k] * math.sqrt(legs.square[k])
        return Along(float(s), legs.place(k, float(part[k])), float(aside[k]))

    def at(self, s: float) -> Vec3:
        """The place so far along the way; beyond its end straight on."""
        legs = self._legs
        k = min(max(int(np.searchsorted(legs.before, s)) - 1, 0), len(legs.square) - 1)
        return legs.place(k, float((s - legs.before[k]) / math.sqrt(legs.square[k])))

    def _begin(self) -> Vec3:
        north, east, down = self.path_ned_m[0]
        return (north, east, down - 0.5 * sum(self.height_m))

    def _lookout(self, s: float) -> Iterator[Vec3]:
        return (self.at(s + 0.5 * k) for k in range(int(2 * _LOOKOUT_M) + 1))


def looking(p: Vec3, q: Sequence[float], view_deg: float) -> Eye:
    """The eye at a pose in N, that sees well in a cone of this whole angle about its axis x."""
    return Eye(p, rotate(q, (1.0, 0.0, 0.0)), math.cos(0.5 * rad(view_deg)))
