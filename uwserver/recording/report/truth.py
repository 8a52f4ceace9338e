"""Where a vehicle really was, from the truth in its recording; and where its sensors sat on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from uwserver.frames import matrix, quat_from_rpy
from uwserver.recording.report.columns import FloatArray
from uwserver.recording.report.reading import IntArray, Recorded
from uwserver.units import rad

_TICK_S = 1e-6
"""Times closer than this are of the same tick."""
_COINCIDENT = 20
"""Samples at instants of the truth that are enough to be compared alone, without interpolation."""


@dataclass(frozen=True)
class Truth:
    """Of one vehicle.

    Attributes:
        t: (n) s, strictly increasing.
        p_NB: (n, 3) m.
        q_NB: (n, 4) w x y z, continuous in sign.
        v_NB_B, w_NB_B, v_dot_B, w_dot_B: (n, 3) m/s, rad/s and their derivatives; None where they were not recorded.
    """

    t: FloatArray
    p_NB: FloatArray
    q_NB: FloatArray
    v_NB_B: FloatArray | None = None
    w_NB_B: FloatArray | None = None
    v_dot_B: FloatArray | None = None
    w_dot_B: FloatArray | None = None

    def pairs(self, t: FloatArray) -> IntArray:
        """Which of the samples at `t` are compared: those of the same tick if there are enough, else all within the truth; as indices (m)."""
        inside = np.flatnonzero((t >= self.t[0] - _TICK_S) & (t <= self.t[-1] + _TICK_S))
        nearest = np.clip(np.searchsorted(self.t, t[inside] - _TICK_S), 0, len(self.t) - 1)
        same = inside[np.abs(self.t[nearest] - t[inside]) <= _TICK_S]
        return same if len(same) >= _COINCIDENT else inside

    def at(self, t: FloatArray, name: str) -> FloatArray:
        """One of the attributes at times (m) within it, (m, k): linear between two, attitudes normalised."""
        rows: FloatArray = getattr(self, name)
        found = np.stack([np.interp(t, self.t, column) for column in rows.T], axis=1)
        if name == "q_NB":
            found /= np.linalg.norm(found, axis=1, keepdims=True)
        return found


@dataclass(frozen=True)
class Mount:
    """Of a sensor: p_BS (m), and R_BS, which turns components in S into B."""

    p: FloatArray
    R: FloatArray


def truth_of(recorded: Recorded, vehicle: str) -> Truth | None:
    """From ``<vehicle>/truth/...``, or the poses of the states; None where neither was recorded."""
    pose = recorded.series.get(f"{vehicle}/truth/pose")
    if pose is not None and {"p_NB", "q_NB"} <= pose.columns.keys():
        rows = np.column_stack([pose.t, pose.columns["p_NB"], pose.columns["q_NB"]])
    else:
        rows = recorded.poses.get(vehicle, np.zeros((0, 8)))
    t, first = np.unique(rows[:, 0], return_index=True)
    p, q = rows[first, 1:4], rows[first, 4:8]
    good = np.isfinite(p).all(axis=1) & np.isfinite(q).all(axis=1) & (np.linalg.norm(q, axis=1) > 0.5)
    t, p, q = t[good], p[good], q[good]
    if not len(t):
        return None
    turns = np.concatenate([[False], np.einsum("ij,ij->i", q[1:], q[:-1]) < 0.0])
    q = q * np.where(np.cumsum(turns) % 2, -1.0, 1.0)[:, None]
    rates: dict[str, FloatArray | None] = {}
    for port, names in (("velocity", ("v_NB_B", "w_NB_B")), ("acceleration", ("v_dot_B", "w_dot_B"))):
        series = recorded.series.get(f"{vehicle}/truth/{port}")
        for name in names:
            found = None if series is None else series.columns.get(name)
            if series is not None and found is not None:
                times, each = np.unique(series.t, return_index=True)
                found = np.stack([np.interp(t, times, column, math.nan, math.nan) for column in found[each].T], axis=1)
            rates[name] = found
    return Truth(t, p, q, **rates)


def mount_of(table: Mapping[str, Any], mounts: Mapping[str, Any]) -> Mount:
    """Of a sensor's table as the head has it; a named mount of the vehicle stands for its own place."""
    named = mounts.get(table.get("mount", ""), {})
    place = {**table, **{key: value for key, value in named.items() if key in ("position_frd_m", "rpy_deg")}}
    position, angles = place.get("position_frd_m", (0.0, 0.0, 0.0)), place.get("rpy_deg", (0.0, 0.0, 0.0))
    roll, pitch, yaw = (rad(float(a)) for a in angles)
    return Mount(np.array(position, dtype=float), np.array(matrix(quat_from_rpy(roll, pitch, yaw))))


def rotations(q: FloatArray) -> FloatArray:
    """(n, 3, 3) of unit quaternions (n, 4)."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def euler(R: FloatArray) -> FloatArray:
    """(n, 3) roll, pitch, yaw, rad, of rotations (n, 3, 3)."""
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    pitch = np.arcsin(np.clip(-R[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    return np.stack([roll, pitch, yaw], axis=1)


def small_angles(R: FloatArray) -> FloatArray:
    """(n, 3) rotation vectors, rad, of rotations (n, 3, 3) that are far from half a turn."""
    vector = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.linalg.norm(vector, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    scale = np.divide(angle, sine, out=np.ones_like(angle), where=sine > 1e-12)
    turned: FloatArray = vector * scale[:, None]
    return turned
