"""Sensors of one kind as rows of a bank, which compiled code measures all at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.kernel.deferred import Elsewhere

HEAD = np.dtype(
    [
        ("body", "i8"),  # row of the body that carries it
        ("row", "i8"),  # in the bank of its kind
        ("first", "i8"),  # place of its last reading among the numbers of the world
        ("width", "i8"),
        ("exact_first", "i8"),  # place of what it would have read without errors; -1 where nobody asks
        ("stream_first", "i8"),  # its own stream, and the others
        ("stream_count", "i8"),
        ("number", "i8"),  # readings made
        ("key", "u8"),  # of its random numbers
        ("p", "f8", (3,)),  # p_BS, m
        ("q", "f8", (4,)),  # q_BS
        ("dt", "f8"),  # time between readings, s
        ("latency_ns", "i8"),
        ("exact", "i8"),  # 1: it has no errors of its own
        # Of the last reading, as `modifiers.Measurement`:
        ("ready", "i8"),  # 0: it had none to give
        ("valid", "i8"),
        ("exact_valid", "i8"),
        ("delay_ns", "i8"),
        ("since_ns", "i8"),
    ]
)
"""What the rows of all kinds have."""

MISSING = np.nan
"""A number that a reading does not have."""

_INSTANT = "uwserver.sensors.instant"
rotate, multiply = Elsewhere(_INSTANT, "rotate"), Elsewhere(_INSTANT, "multiply")
conjugate, quat_from_rpy = Elsewhere(_INSTANT, "conjugate"), Elsewhere(_INSTANT, "quat_from_rpy")
rpy_from_quat = Elsewhere(_INSTANT, "rpy_from_quat")
p_NB, q_NB = Elsewhere(_INSTANT, "p_NB"), Elsewhere(_INSTANT, "q_NB")
v_NB_B, w_NB_B = Elsewhere(_INSTANT, "v_NB_B"), Elsewhere(_INSTANT, "w_NB_B")
p_NS, q_NS, q_BS, p_BS = (Elsewhere(_INSTANT, name) for name in ("p_NS", "q_NS", "q_BS", "p_BS"))
velocity_of, specific_force = Elsewhere(_INSTANT, "velocity_of"), Elsewhere(_INSTANT, "specific_force")
water_property, depth_of = Elsewhere(_INSTANT, "water_property"), Elsewhere(_INSTANT, "depth_of")
place_of, gauge_pressure = Elsewhere(_INSTANT, "place_of"), Elsewhere(_INSTANT, "gauge_pressure")
water_velocity, submergence = Elsewhere(_INSTANT, "water_velocity"), Elsewhere(_INSTANT, "submergence")
nu_dot_at, tau_at, thrusters_at, lags_at = (
    Elsewhere(_INSTANT, name) for name in ("nu_dot_at", "tau_at", "thrusters_at", "lags_at")
)


def record(*fields: Any) -> np.dtype[Any]:
    """The row of a kind: parameters, then what it remembers."""
    return np.dtype(list(fields), align=True)
