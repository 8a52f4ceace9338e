"""A track: poses of one body at instants, and the interpolation between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from uwserver.frames import Quat, Vec3, conjugate, multiply, rotate
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.world.external.motion import Motion

Outside = Literal["hide", "hold"]
"""Before the first pose and after the last one the body is nowhere ("hide"), or stands at the nearest pose ("hold")."""
MAX_GAP_S = 1.0
"""Poses are not interpolated across a longer gap."""
FARTHEST_M = 1e6
"""Largest distance from the origin of N. A larger one is a fault of the source, and single precision could not show it."""
FASTEST_MPS, FASTEST_RADPS = 100.0, 100.0
"""A body that seems to be faster has jumped. It is moved, but has no velocity with which it could hit anything."""
_SECOND, _NANOSECOND = 1e9, 1e-9


class TrackPose(NamedTuple):
    """The pose of a track at an instant.

    Attributes:
        p_NB: m.
        q_NB: w x y z, unit.
        nu: v_NB_B (m/s) and w_NB_B (rad/s), in B; zero while the body is held, and after a jump.
        age_s: time since the newest pose at or before the instant; negative before the first pose of a track that is held.
    """

    p_NB: Vec3
    q_NB: Quat
    nu: tuple[float, float, float, float, float, float]
    age_s: float


AT_REST = (0.0,) * 6


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Poses of one body B in N at instants of one clock.

    Attributes:
        t_ns: (n,) int64, strictly rising, ns of that clock.
        p_NB: (n, 3) m.
        q_NB: (n, 4) unit quaternions, w x y z; either sign.
        v_N: (n, 3) velocity of the origin of B in N, m/s; None if it is not known.
        motion: outputs of the actuators on the same clock; None if they are not known.

    Raises:
        ValueError: no pose, other shapes, a number that is not finite, times that do not rise, a quaternion that is not a unit one, or a
            position farther than `FARTHEST_M`. `cleaned` makes a track of such poses and says what it left out.
    """

    t_ns: IntArray
    p_NB: FloatArray
    q_NB: FloatArray
    v_N: FloatArray | None = None
    motion: Motion | None = None

    def __post_init__(self) -> None:
        n = len(self.t_ns)
        if n == 0:
            raise ValueError("a track needs at least one pose")
        arrays = [(self.t_ns, (n,), np.int64), (self.p_NB, (n, 3), np.float64), (self.q_NB, (n, 4), np.float64)]
        arrays += [] if self.v_N is None else [(self.v_N, (n, 3), np.float64)]
        for array, shape, kind in arrays:
            if array.shape != shape or array.dtype != kind:
                raise ValueError(f"a track has an array of {array.dtype} {array.shape}, not {np.dtype(kind)} {shape}")
            if not np.isfinite(array).all():
                raise ValueError("a track has a number that is not finite")
        if (np.diff(self.t_ns) <= 0).any():
            raise ValueError("the times of a track must rise")
        if (np.abs(np.linalg.norm(self.q_NB, axis=1) - 1.0) > 1e-6).any():
            raise ValueError("a track has a quaternion that is no unit quaternion")
        if (np.abs(self.p_NB) > FARTHEST_M).any():
            raise ValueError(f"a track has a position farther than {FARTHEST_M:g} m from the origin")

    def __len__(self) -> int:
        return len(self.t_ns)

    def at(self, t_ns: int, outside: Outside = "hide", max_gap_s: float = MAX_GAP_S) -> TrackPose | None:
        """Return the pose at an instant; None if the track does not say.

        Between two poses the position follows a cubic Hermite curve if velocities are known, else a straight line. The attitude turns
        evenly, the shorter way.

        Args:
            t_ns: time on the track's clock.
            outside: what holds before the first pose and after the last one.
            max_gap_s: between poses that are farther apart in time, the body is nowhere, or held at the earlier one.
        """
        segment = self.segment(t_ns, max_gap_s)
        if segment is not None:
            return segment.at(t_ns)
        k = int(np.searchsorted(self.t_ns, t_ns, side="right")) - 1
        if k >= 0 and t_ns == self.t_ns[k]:
            return self._still(k, t_ns)
        return None if outside == "hide" else self._still(max(k, 0), t_ns)

    def segment(self, t_ns: int, max_gap_s: float = MAX_GAP_S) -> PathSegment | None:
        """Return the segment between the two poses around an instant; None outside the track and in a gap. A caller that asks tick after
        tick keeps the segment."""
        k = int(np.searchsorted(self.t_ns, t_ns, side="right")) - 1
        if not 0 <= k < len(self.t_ns) - 1:
            return None
        span = int(self.t_ns[k + 1] - self.t_ns[k])
        return self._between(k, span) if span <= round(max_gap_s * _SECOND) else None

    def _still(self, k: int, t_ns: int) -> TrackPose:
        return TrackPose(
            _numbers(self.p_NB[k]), _numbers(self.q_NB[k]), AT_REST, (t_ns - int(self.t_ns[k])) * _NANOSECOND
        )

    def _between(self, k: int, span_ns: int) -> PathSegment:
        dt = span_ns * _NANOSECOND
        p0, d = self.p_NB[k], self.p_NB[k + 1] - self.p_NB[k]
        if self.v_N is None:
            slope, bend, twist = d, np.zeros(3), np.zeros(3)
        else:
            slope, end = self.v_N[k] * dt, self.v_N[k + 1] * dt
            bend, twist = 3.0 * d - 2.0 * slope - end, slope + end - 2.0 * d
        cubic = _numbers(p0), _numbers(slope), _numbers(bend), _numbers(twist)
        turn = rotation_vector(self.q_NB[k].tolist(), self.q_NB[k + 1].tolist())
        return PathSegment(int(self.t_ns[k]), span_ns, cubic, _numbers(self.q_NB[k]), turn)


class PathSegment(NamedTuple):
    """The segment from one pose to the next.

    Attributes:
        first_ns, span_ns: time of the first pose, and from there to the second.
        cubic: coefficients of the powers of s for the position, m; s runs from 0 to 1 along the segment.
        q_NB: first attitude.
        turn: turn along the whole segment: axis times angle (rad), in B.
    """

    first_ns: int
    span_ns: int
    cubic: tuple[Vec3, Vec3, Vec3, Vec3]
    q_NB: Quat
    turn: Vec3

    def holds(self, t_ns: int) -> bool:
        """Return whether an instant lies on the segment. Its end belongs to the next segment."""
        return 0 <= t_ns - self.first_ns < self.span_ns

    def at(self, t_ns: int) -> TrackPose:
        """Return the pose at an instant on the segment."""
        s, dt = (t_ns - self.first_ns) / self.span_ns, self.span_ns * _NANOSECOND
        (ax, ay, az), (bx, by, bz), (cx, cy, cz), (dx, dy, dz) = self.cubic
        p = (ax + s * (bx + s * (cx + s * dx)), ay + s * (by + s * (cy + s * dy)), az + s * (bz + s * (cz + s * dz)))
        twice, thrice = 2.0 * s, 3.0 * s * s
        v = (
            (bx + twice * cx + thrice * dx) / dt,
            (by + twice * cy + thrice * dy) / dt,
            (bz + twice * cz + thrice * dz) / dt,
        )
        wx, wy, wz = self.turn
        q = turned(self.q_NB, (s * wx, s * wy, s * wz))
        return TrackPose(p, q, body_velocity(q, v, (wx / dt, wy / dt, wz / dt)), (t_ns - self.first_ns) * _NANOSECOND)


def body_velocity(q_NB: Quat, v_N: Vec3, w_B: Vec3) -> tuple[float, float, float, float, float, float]:
    """Return nu for a velocity in N (m/s) and an angular velocity in B (rad/s); zero if they are too large for a motion, so that the body
    has jumped."""
    if not (math.hypot(*v_N) <= FASTEST_MPS and math.hypot(*w_B) <= FASTEST_RADPS):
        return AT_REST
    return (*rotate(conjugate(q_NB), v_N), *w_B)


def rotation_vector(q_NA: Sequence[float], q_NB: Sequence[float]) -> Vec3:
    """Return the turn from attitude A to B, the shorter way: axis times angle (rad), in A. The vector is the same in B."""
    w, x, y, z = multiply(conjugate(q_NA), q_NB)
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    # Below 1e-9 the angle is twice its half's sine; above, atan2 is exact at all angles.
    factor = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return factor * x, factor * y, factor * z


def turned(q_NB: Quat, turn_B: Vec3) -> Quat:
    """Return an attitude after a turn by axis times angle (rad) in B, as a unit quaternion."""
    angle = math.hypot(*turn_B)
    factor = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    q = multiply(q_NB, (math.cos(0.5 * angle), *(factor * c for c in turn_B)))
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm


def _numbers(row: FloatArray) -> Any:
    return tuple(row.tolist())


def cleaned(
    t_ns: IntArray, p_NB: FloatArray, q_NB: FloatArray, v_N: FloatArray | None = None
) -> tuple[PoseTrack, tuple[str, ...]]:
    """Make a track of poses from a foreign source. Returns it with sentences that say what was left out.

    Poses are left out if they have numbers that are not finite, a quaternion of zero length, or a position farther than `FARTHEST_M`. A
    pose that comes after a newer one is left out too. Of two poses at one instant the later one counts. Quaternions are normalised.

    Args:
        t_ns: (n,) ns.
        p_NB: (n, 3) m.
        q_NB: (n, 4) of any length but 0.
        v_N: (n, 3) m/s, or None.

    Raises:
        ValueError: other shapes, or no pose is left.
    """
    t, p, q = np.asarray(t_ns, np.int64), np.asarray(p_NB, np.float64), np.asarray(q_NB, np.float64)
    v = None if v_N is None else np.asarray(v_N, np.float64)
    if t.ndim != 1 or p.shape != (len(t), 3) or q.shape != (len(t), 4) or (v is not None and v.shape != p.shape):
        raise ValueError(f"times {t.shape}, positions {p.shape} and quaternions {q.shape} do not make poses")
    numbers = (p, q) if v is None else (p, q, v)
    finite = np.all([np.isfinite(array).all(axis=1) for array in numbers], axis=0)
    norms = np.linalg.norm(np.where(np.isfinite(q), q, 0.0), axis=1)
    is_turn = (norms > 1e-6) & np.isfinite(norms)
    near = (np.abs(np.where(np.isfinite(p), p, 0.0)) <= FARTHEST_M).all(axis=1)
    good = finite & is_turn & near
    told = [(~finite, "with numbers that are not finite"), (finite & ~is_turn, "with a quaternion of no length")]
    told += [(finite & is_turn & ~near, f"farther than {FARTHEST_M:g} m from the origin")]
    rows = np.flatnonzero(good)
    late = t[rows] < np.maximum.accumulate(t[rows])
    rows = rows[~late]
    replaced = np.append(t[rows][1:] == t[rows][:-1], np.zeros(min(len(rows), 1), np.bool_))
    remarks = [f"{int(mask.sum())} poses {why} were left out" for mask, why in told if mask.any()]
    if late.any():
        remarks.append(f"{int(late.sum())} poses were left out because they came after a newer one")
    if replaced.any():
        remarks.append(f"{int(replaced.sum())} poses were replaced by a later one of the same instant")
    keep = rows[~replaced]
    if not len(keep):
        raise ValueError("; ".join(("no pose is left", *remarks)))
    speeds = None if v is None else np.ascontiguousarray(v[keep])
    track = PoseTrack(t[keep], np.ascontiguousarray(p[keep]), q[keep] / norms[keep, None], speeds)
    return track, tuple(remarks)
