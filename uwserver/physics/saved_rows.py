"""Checks arrays of bodies that come from outside."""

from __future__ import annotations

from typing import Any

import numpy as np

_FLAGS = dict.fromkeys(("in_contact", "by_force", "fresh", "frame", "harmonic"), 1) | dict.fromkeys(
    ("retired", "stuck", "form_M_RB", "form_M_A", "form_D_L", "form_D_Q", "form_D_S"), 2
)
"""Largest values of the whole numbers that change in a run. All other whole numbers say which rows belong together, and never change."""
_ENDLESS = ("rate", "floor")
"""Fields that may be infinite: the rate of a servo without a limit, and the depth where there is no bottom. While a servo is stuck its rate is 0, and
an earlier state with an infinite rate must still be accepted."""


def check_rows(name: str, new: Any, now: Any) -> None:
    """Raise ValueError for a number that is not finite, unless its field may be without a limit, and for an impossible whole number."""
    if new.dtype.names is None:
        if new.dtype.kind == "f" and not np.isfinite(new).all():
            raise ValueError(f'"{name}" holds what is not finite')
        return
    for field in new.dtype.names:
        after, before = new[field], now[field]
        if after.dtype.kind == "f":
            if not (np.isfinite(after) | ((after == np.inf) & (field in _ENDLESS))).all():
                raise ValueError(f'"{name}" holds a {field} that is not finite')
        elif field in _FLAGS:
            if ((after < 0) | (after > _FLAGS[field])).any():
                raise ValueError(f'"{name}" holds an impossible {field}')
        elif (after != before).any():
            raise ValueError(f'"{name}" is of other bodies ({field})')
