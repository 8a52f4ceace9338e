"""The sources of an external body's poses: a track that was read before the run, or commands that come in during the run."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Protocol

import numpy as np
from msgspec import Meta, Struct

from uwserver.frames import IDENTITY, Quat, Vec3, rotate
from uwserver.ports import Fault, Field, Items
from uwserver.units import NANOSECONDS
from uwserver.world.external.track import (
    AT_REST,
    FARTHEST_M,
    FASTEST_MPS,
    FASTEST_RADPS,
    MAX_GAP_S,
    Outside,
    PathSegment,
    PoseTrack,
    TrackPose,
    body_velocity,
    rotation_vector,
    turned,
)

PREDICT_S = 0.2
"""If nothing newer comes, a body keeps its velocity for so long: the time between two poses of a source of 5 Hz."""


class PoseSource(Protocol):
    """Gives the pose of a body."""

    def at(self, t_ns: int) -> TrackPose | None:
        """Return the pose at a simulation time; None if it is not known."""

    def age_s(self, t_ns: int) -> float | None:
        """Return the age (s) of the newest pose that is known at this time; None before the first."""

    def count(self, t_ns: int) -> int:
        """Return the number of poses up to this time."""


class RecordedPoses:
    """A track that was read before the run.

    Args:
        track: its times are simulation times, ns.
        outside, max_gap_s: as in `PoseTrack.at`.
    """

    def __init__(self, track: PoseTrack, outside: Outside = "hide", max_gap_s: float = MAX_GAP_S) -> None:
        self._track, self._outside, self._max_gap_s = track, outside, max_gap_s
        self._segment: PathSegment | None = None

    def at(self, t_ns: int) -> TrackPose | None:
        """See `PoseSource`."""
        if self._segment is None or not self._segment.holds(t_ns):
            self._segment = self._track.segment(t_ns, self._max_gap_s)
        if self._segment is not None:
            return self._segment.at(t_ns)
        return self._track.at(t_ns, self._outside, self._max_gap_s)

    def age_s(self, t_ns: int) -> float | None:
        """See `PoseSource`."""
        k = self.count(t_ns)
        return None if k == 0 else (t_ns - int(self._track.t_ns[k - 1])) / NANOSECONDS

    def count(self, t_ns: int) -> int:
        """See `PoseSource`."""
        return int(np.searchsorted(self._track.t_ns, t_ns, side="right"))


Metres = Annotated[float, Meta(ge=-FARTHEST_M, le=FARTHEST_M)]
_Part = Annotated[float, Meta(ge=-1.0 - 1e-9, le=1.0 + 1e-9)]
_Speed = Annotated[float, Meta(ge=-2 * FASTEST_MPS, le=2 * FASTEST_MPS)]


class NewestPose(Struct, frozen=True):
    """The newest pose that has come.

    Attributes:
        t_ns: simulation time at which it came; negative before the first.
        stamp: time of the pose on the clock of the sender, s; None if the sender gave none.
        p_NB, q_NB: position (m) and attitude (w x y z).
        nu: v_NB_B (m/s) and w_NB_B (rad/s): as the sender gave them, else derived from the pose before.
        count: number of poses so far.
    """

    t_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    stamp: float | None = None
    p_NB: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    q_NB: tuple[_Part, _Part, _Part, _Part] = IDENTITY
    nu: tuple[_Speed, _Speed, _Speed, _Speed, _Speed, _Speed] = AT_REST
    count: Annotated[int, Meta(ge=0, le=2**62)] = 0


def _limited(name: str, unit: str, doc: str, frame: str, limit: float, size: int = 3) -> Field:
    return Field(name, unit, doc, frame, (size,), minimum=-limit, maximum=limit)


class LivePoses:
    """Poses that come as commands to an actuator's port.

    Between two poses the body keeps the velocity that came with the newer one, or that follows from both, but for no longer than
    `predict_s`. Then it stands.

    Attributes:
        memory: the newest pose.
    """

    doc = "Sets the pose of the body, which follows and cannot be pushed."
    fields = (
        _limited("p_NB", "m", "position of the body origin; needed", "N", FARTHEST_M),
        _limited("q_NB", "1", "attitude, w x y z; is normalised; default: unchanged", "NB", 1e6, size=4),
        _limited("v_NB_B", "m/s", "velocity; default: derived from the pose before", "B", FASTEST_MPS),
        _limited("w_NB_B", "rad/s", "angular velocity; default: derived from the pose before", "B", FASTEST_RADPS),
        Field("stamp", "s", "time of the pose on the sender's own clock; an older one than before is refused"),
    )

    def __init__(
        self,
        now_ns: Callable[[], int],
        start: TrackPose,
        outside: Outside = "hide",
        max_gap_s: float = MAX_GAP_S,
        predict_s: float = PREDICT_S,
    ) -> None:
        """Begin without any pose.

        Args:
            now_ns: gives the simulation time.
            start: pose before the first one comes, if `outside` is "hold".
            outside: "hide": the body is nowhere if no pose came for `max_gap_s`; "hold": it stays.
            max_gap_s: s.
            predict_s: how long the body keeps its velocity, s.
        """
        self._now_ns, self._start, self._outside = now_ns, start, outside
        self._max_gap_s, self._predict_s = max_gap_s, predict_s
        self.memory = NewestPose()

    def objection(self, value: Items) -> Fault | None:
        """Return why a pose is refused, as a text for the sender; None if it is accepted."""
        p, *_, stamp = value
        if p is None:
            return Fault("bad_argument", "needs p_NB: a pose must have a position")
        before = self.memory.stamp
        if stamp is not None and before is not None and _numbers(stamp)[0] < before:
            return Fault(
                "bad_argument",
                f"has a pose of {before:g} s already, and this one is of {_numbers(stamp)[0]:g} s: poses must come in the order of their stamps. "
                "Leave the stamp out once if your clock was set back",
            )
        return None

    def apply(self, value: Items) -> None:
        """Take over a pose. `objection` has been asked before."""
        before, now = self.memory, self._now_ns()
        p_given, q_given, v, w, stamp_given = value
        if p_given is None:
            return
        p: Vec3 = _numbers(p_given)  # type: ignore[assignment]  # three of them
        q = before.q_NB
        if q_given is not None:
            norm = math.hypot(*_numbers(q_given))
            q = tuple(c / norm for c in _numbers(q_given))  # type: ignore[assignment]  # four of them
        stamp = None if stamp_given is None else _numbers(stamp_given)[0]
        passed = (now - before.t_ns) / NANOSECONDS if before.count else 0.0
        if stamp is not None and before.stamp is not None:
            passed = stamp - before.stamp
        nu = _between(before, p, q, passed) if 0.0 < passed <= self._max_gap_s else AT_REST
        linear = nu[:3] if v is None else _numbers(v)
        angular = nu[3:] if w is None else _numbers(w)
        self.memory = NewestPose(now, stamp, p, q, (*linear, *angular), before.count + 1)  # type: ignore[arg-type]  # six

    def neutral(self) -> None:
        """Do nothing: the body stays at its pose."""

    def at(self, t_ns: int) -> TrackPose | None:
        """See `PoseSource`."""
        newest, age = self.memory, self.age_s(t_ns)
        if age is None:
            return None if self._outside == "hide" else self._start
        if age > self._max_gap_s:
            held = TrackPose(newest.p_NB, newest.q_NB, AT_REST, age)
            return None if self._outside == "hide" else held
        ahead = min(age, self._predict_s)
        v = rotate(newest.q_NB, newest.nu[:3])
        p = (newest.p_NB[0] + v[0] * ahead, newest.p_NB[1] + v[1] * ahead, newest.p_NB[2] + v[2] * ahead)
        wx, wy, wz = newest.nu[3:]
        q = turned(newest.q_NB, (wx * ahead, wy * ahead, wz * ahead))
        return TrackPose(p, q, newest.nu if age <= self._predict_s else AT_REST, age)

    def age_s(self, t_ns: int) -> float | None:
        """See `PoseSource`."""
        return (t_ns - self.memory.t_ns) / NANOSECONDS if self.memory.count else None

    def count(self, t_ns: int) -> int:
        """See `PoseSource`."""
        return self.memory.count


def _numbers(item: Any) -> tuple[float, ...]:
    """Return the numbers of a field of a checked command."""
    return tuple(item)


def _between(before: NewestPose, p: Vec3, q: Quat, seconds: float) -> tuple[float, ...]:
    """Return the nu that leads from one pose to another in `seconds`."""
    v = [(new - old) / seconds for new, old in zip(p, before.p_NB, strict=True)]
    turn = rotation_vector(before.q_NB, q)
    return body_velocity(q, (v[0], v[1], v[2]), (turn[0] / seconds, turn[1] / seconds, turn[2] / seconds))
