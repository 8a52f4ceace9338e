"""Reads the true motion of a vehicle from a recording, and the places of its sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from uwserver.frames import matrix, quat_from_rpy
from uwserver.recording.report.reading import FloatArray, IntArray, Recorded
from uwserver.units import rad

_TICK_S = 1e-6
"""Times closer than this belong to the same tick."""
_COINCIDENT = 20
"""If this many samples have the times of the truth, only these are compared, without interpolation."""


@dataclass(frozen=True)
class Truth:
    """The true motion of one vehicle.

    Attributes:
        t: (n) s, strictly increasing.
        p_NB: (n, 3) m.
        q_NB: (n, 4) w x y z, continuous in sign.
        v_NB_B, w_NB_B, v_dot_B, w_dot_B: (n, 3) m/s, rad/s and their derivatives; None if they were not recorded.
    """

    t: FloatArray
    p_NB: FloatArray
    q_NB: FloatArray
    v_NB_B: FloatArray | None = None
    w_NB_B: FloatArray | None = None
    v_dot_B: FloatArray | None = None
    w_dot_B: FloatArray | None = None

    def pairs(self, t: FloatArray) -> IntArray:
        """Return the indices (m) of the samples at `t` (n) that are compared: those at ticks of the truth if there are enough, else all within it."""
        inside = np.flatnonzero((t >= self.t[0] - _TICK_S) & (t <= self.t[-1] + _TICK_S))
        nearest = np.clip(np.searchsorted(self.t, t[inside] - _TICK_S), 0, len(self.t) - 1)
        same = inside[np.abs(self.t[nearest] - t[inside]) <= _TICK_S]
        return same if len(same) >= _COINCIDENT else inside

    def at(self, t: FloatArray, name: str) -> FloatArray:
        """Return an attribute (m, k) at times (m): interpolated linearly, attitudes normalised."""
        rows: FloatArray = getattr(self, name)
        found = np.stack([np.interp(t, self.t, column) for column in rows.T], axis=1)
        if name == "q_NB":
            found /= np.linalg.norm(found, axis=1, keepdims=True)
        return found


@dataclass(frozen=True)
class Mount:
    """The place of a sensor: p_BS (m), and R_BS, which turns components in S into components in B."""

    p: FloatArray
    R: FloatArray


def truth_of(recorded: Recorded, vehicle: str) -> Truth | None:
    """Return the truth from ``<vehicle>/truth/...``, or else from the recorded poses; None if neither was recorded."""
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
    """Return the place of a sensor from its table in the head. If the table names a mount of the vehicle, that gives the place."""
    named = mounts.get(table.get("mount", ""), {})
    place = {**table, **{key: value for key, value in named.items() if key in ("position_frd_m", "rpy_deg")}}
    position, angles = place.get("position_frd_m", (0.0, 0.0, 0.0)), place.get("rpy_deg", (0.0, 0.0, 0.0))
    roll, pitch, yaw = (rad(float(a)) for a in angles)
    return Mount(np.array(position, dtype=float), np.array(matrix(quat_from_rpy(roll, pitch, yaw))))


def rotations(q: FloatArray) -> FloatArray:
    """Return rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    columns: Any = q.T  # the function for one quaternion also takes its four components as arrays
    return np.moveaxis(np.array(matrix(columns)), 2, 0)


def euler(R: FloatArray) -> FloatArray:
    """Return roll, pitch, yaw (n, 3), rad, of rotations (n, 3, 3)."""
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    pitch = np.arcsin(np.clip(-R[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    return np.stack([roll, pitch, yaw], axis=1)


def small_angles(R: FloatArray) -> FloatArray:
    """Return rotation vectors (n, 3), rad, of rotations (n, 3, 3) that are far from half a turn."""
    vector = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.linalg.norm(vector, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    scale = np.divide(angle, sine, out=np.ones_like(angle), where=sine > 1e-12)
    turned: FloatArray = vector * scale[:, None]
    return turned
