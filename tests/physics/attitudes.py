"""Attitudes of a whole run at once: the functions of `uwserver.frames` take one at a time."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import Q


def rpy_deg(states: FloatArray) -> FloatArray:
    """(steps, n, 3) roll, pitch and unwrapped yaw, degrees, of states (steps, n, 13)."""
    w, x, y, z = _quaternions(states)
    roll = np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
    yaw = np.unwrap(np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)), axis=0)
    return np.degrees(np.stack([roll, pitch, yaw], axis=2))


def upright(states: FloatArray) -> FloatArray:
    """(steps, n) cosine of the tilt; negative: on its back."""
    _, x, y, _ = _quaternions(states)
    cosine: FloatArray = 1.0 - 2.0 * (x * x + y * y)
    return cosine


def _quaternions(states: FloatArray) -> FloatArray:
    """(4, steps, n)."""
    q = np.moveaxis(states[:, :, Q : Q + 4], 2, 0)
    unit: FloatArray = q / np.linalg.norm(q, axis=0)
    return unit
