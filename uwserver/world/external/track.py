"""A track: poses of one body at instants, and where it was between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from uwserver.frames import Quat, Vec3, conjugate, multiply, rotate
from uwserver.physics.kernel.arrays import FloatArray, IntArray

Outside = Literal["hide", "hold"]
"""Before the first pose and after the last: the body is nowhere, or stands where the nearest pose says."""
MAX_GAP_S = 1.0
"""A longer gap between two poses is not bridged."""
FARTHEST_M = 1e6
"""From the origin of N. What is farther is a fault of the source, and single precision would no longer show it."""
FASTEST_MPS, FASTEST_RADPS = 100.0, 100.0
"""A body that seems to be faster has jumped: it is moved, but has no velocity at which it could strike anything."""
_SECOND, _NANOSECOND = 1e9, 1e-9


class TrackPose(NamedTuple):
    """Where a track is at an instant.

    Attributes:
        p_NB: m.
        q_NB: w x y z, unit.
        nu: v_NB_B (m/s) and w_NB_B (rad/s), in B; zero where the body is held, and where it has jumped.
        age_s: since the newest pose at or before the instant; negative before the first pose of a track that is held.
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
        v_N: (n, 3) velocity of the origin of B in N, m/s; None where it is not known.

    Raises:
        ValueError: no pose at all, other shapes, numbers that are not finite, times that do not rise, no unit quaternion, or farther than
            `FARTHEST_M`. `cleaned` makes a track of such poses and says what it left out.
    """

    t_ns: IntArray
    p_NB: FloatArray
    q_NB: FloatArray
    v_N: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(self.t_ns)
        if n == 0:
            raise ValueError("a track needs a pose")
        arrays = [(self.t_ns, (n,), np.int64), (self.p_NB, (n, 3), np.float64), (self.q_NB, (n, 4), np.float64)]
        arrays += [] if self.v_N is None else [(self.v_N, (n, 3), np.float64)]
        for array, shape, kind in arrays:
            if array.shape != shape or array.dtype != kind:
                raise ValueError(f"an array of {array.dtype} {array.shape} in a track, not {np.dtype(kind)} {shape}")
            if not np.isfinite(array).all():
                raise ValueError("a number in a track that is not finite")
        if (np.diff(self.t_ns) <= 0).any():
            raise ValueError("the times of a track must rise")
        if (np.abs(np.linalg.norm(self.q_NB, axis=1) - 1.0) > 1e-6).any():
            raise ValueError("a quaternion in a track that is no rotation")
        if (np.abs(self.p_NB) > FARTHEST_M).any():
            raise ValueError(f"a position in a track farther than {FARTHEST_M:g} m from the origin")

    def __len__(self) -> int:
        return len(self.t_ns)

    def at(self, t_ns: int, outside: Outside = "hide", max_gap_s: float = MAX_GAP_S) -> TrackPose | None:
        """Where the body is at an instant; None where the track does not say.

        Between two poses the position is a cubic Hermite curve where velocities are known, else a straight line; the attitude turns evenly
        on the shorter way.

        Args:
            t_ns: of the track's clock.
            outside: what holds before the first pose and after the last one.
            max_gap_s: between poses that are farther apart in time the body is nowhere, or held at the earlier one.
        """
        k = int(np.searchsorted(self.t_ns, t_ns, side="right")) - 1
        last = len(self.t_ns) - 1
        if 0 <= k < last:
            span = int(self.t_ns[k + 1] - self.t_ns[k])
            if t_ns == self.t_ns[k] or span <= round(max_gap_s * _SECOND):
                return self._between(k, t_ns, span)
        elif k == last and t_ns == self.t_ns[last]:
            return self._still(last, t_ns)
        return None if outside == "hide" else self._still(max(k, 0), t_ns)

    def _still(self, k: int, t_ns: int) -> TrackPose:
        return TrackPose(_vec3(self.p_NB[k]), _quat(self.q_NB[k]), AT_REST, (t_ns - int(self.t_ns[k])) * _NANOSECOND)

    def _between(self, k: int, t_ns: int, span_ns: int) -> TrackPose:
        dt, ahead_ns = span_ns * _NANOSECOND, t_ns - int(self.t_ns[k])
        s = ahead_ns / span_ns
        p0, p1 = self.p_NB[k], self.p_NB[k + 1]
        if self.v_N is None:
            p, v = p0 + s * (p1 - p0), (p1 - p0) / dt
        else:
            p, v = _hermite(p0, p1, self.v_N[k] * dt, self.v_N[k + 1] * dt, s)
            v = v / dt
        turn = rotation_vector(self.q_NB[k].tolist(), self.q_NB[k + 1].tolist())
        q = turned(_quat(self.q_NB[k]), (s * turn[0], s * turn[1], s * turn[2]))
        w = (turn[0] / dt, turn[1] / dt, turn[2] / dt)
        return TrackPose(_vec3(p), q, body_velocity(q, _vec3(v), w), ahead_ns * _NANOSECOND)


def body_velocity(q_NB: Quat, v_N: Vec3, w_B: Vec3) -> tuple[float, float, float, float, float, float]:
    """nu of a velocity in N (m/s) and an angular velocity in B (rad/s); zero where these are no motion but a jump."""
    if not (math.hypot(*v_N) <= FASTEST_MPS and math.hypot(*w_B) <= FASTEST_RADPS):
        return AT_REST
    return (*rotate(conjugate(q_NB), v_N), *w_B)


def rotation_vector(q_NA: Sequence[float], q_NB: Sequence[float]) -> Vec3:
    """The turn from attitude A to B on the shorter way: axis times angle (rad), in A, which is also in B."""
    w, x, y, z = multiply(conjugate(q_NA), q_NB)
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    # Below 1e-9 the angle is twice its half's sine; above, atan2 is exact at all angles.
    factor = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return factor * x, factor * y, factor * z


def turned(q_NB: Quat, turn_B: Vec3) -> Quat:
    """An attitude after a turn by axis times angle (rad) in B; a unit quaternion again."""
    angle = math.hypot(*turn_B)
    factor = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    q = multiply(q_NB, (math.cos(0.5 * angle), *(factor * c for c in turn_B)))
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm


def _hermite(p0: FloatArray, p1: FloatArray, m0: FloatArray, m1: FloatArray, s: float) -> tuple[Any, Any]:
    """A cubic from p0 to p1 with the slopes m0 and m1, at s of 0..1, and its slope there."""
    d = p1 - p0
    a, b = m0 + m1 - 2.0 * d, 3.0 * d - 2.0 * m0 - m1
    return p0 + s * (m0 + s * (b + s * a)), m0 + s * (2.0 * b + s * 3.0 * a)


def _vec3(row: Any) -> Vec3:
    x, y, z = row.tolist()
    return x, y, z


def _quat(row: Any) -> Quat:
    w, x, y, z = row.tolist()
    return w, x, y, z


def cleaned(
    t_ns: IntArray, p_NB: FloatArray, q_NB: FloatArray, v_N: FloatArray | None = None
) -> tuple[PoseTrack, tuple[str, ...]]:
    """A track of poses as a foreign source gives them, and sentences that tell what was left out of it.

    Poses with numbers that are not finite, with a quaternion of no length, or from farther than `FARTHEST_M` are left out; so is whatever
    comes late, when a newer pose was there already; of two at one instant the later counts. Quaternions are normalised.

    Args:
        t_ns: (n,) ns; p_NB: (n, 3) m; q_NB: (n, 4) of any length but 0; v_N: (n, 3) m/s or None.

    Raises:
        ValueError: other shapes, or no pose is left.
    """
    t, p, q = np.asarray(t_ns, np.int64), np.asarray(p_NB, np.float64), np.asarray(q_NB, np.float64)
    v = None if v_N is None else np.asarray(v_N, np.float64)
    if t.ndim != 1 or p.shape != (len(t), 3) or q.shape != (len(t), 4) or (v is not None and v.shape != p.shape):
        raise ValueError(f"times {t.shape}, positions {p.shape} and quaternions {q.shape} are no poses")
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
        remarks.append(f"{int(late.sum())} poses were left out whose time lies before that of an earlier one")
    if replaced.any():
        remarks.append(f"{int(replaced.sum())} poses were replaced by a later one of the same instant")
    keep = rows[~replaced]
    if not len(keep):
        raise ValueError("; ".join(("no pose is left", *remarks)))
    speeds = None if v is None else np.ascontiguousarray(v[keep])
    track = PoseTrack(t[keep], np.ascontiguousarray(p[keep]), q[keep] / norms[keep, None], speeds)
    return track, tuple(remarks)
