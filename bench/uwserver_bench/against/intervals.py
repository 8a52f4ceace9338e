"""Confidence interval of the median of a few ratios."""

from __future__ import annotations

import math
from collections.abc import Sequence


def median_interval(values: Sequence[float], confidence: float = 0.95) -> tuple[float, float] | None:
    """Return the narrowest symmetric pair of order statistics that contains the median with at least this confidence.

    It follows from the sign test: each value lies above the median with probability one half, whatever the distribution (W. J. Conover,
    Practical Nonparametric Statistics, 3rd ed., 1999, section 3.2). Of 15 values these are the 4th and the 12th (96.5 %).

    Args:
        values: independent; their order does not matter.
        confidence: between 0 and 1.

    Returns:
        Both ends; None if there are too few values (fewer than six for 95 %).
    """
    ordered = sorted(values)
    n, outside, cut = len(ordered), 0.0, 0
    while cut < (n + 1) // 2:
        outside += 2.0 * math.comb(n, cut) / 2.0**n
        if outside > 1.0 - confidence:
            break
        cut += 1
    return (ordered[cut - 1], ordered[-cut]) if cut else None
