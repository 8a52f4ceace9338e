"""The lateness of ticks: counted by the simulation thread, read by any thread."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

BUCKETS_S = (1e-5, 2.5e-5, 5e-5, 1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 1e-2, 2.5e-2, 5e-2, 0.1, 0.25)
"""Upper bounds of the histogram, s."""

_RECENT = 8192


class Lateness:
    """Histogram over the whole run, and quantiles over the last 8192 paced ticks.

    Attributes:
        ticks: number of all ticks.
        counts: paced ticks in each bucket, the last one without a bound.
        total_s: sum of the lateness of all paced ticks, s.
    """

    def __init__(self) -> None:
        self.ticks = 0
        self.counts = [0] * (len(BUCKETS_S) + 1)
        self.total_s = 0.0
        self._recent = np.zeros(_RECENT)
        self._paced = 0

    def add(self, late_ns: int) -> None:
        """Count one paced tick."""
        late = late_ns * 1e-9
        self.counts[bisect_left(BUCKETS_S, late)] += 1
        self.total_s += late
        self._recent[self._paced % _RECENT] = late
        self._paced += 1

    def quantiles(self) -> dict[str, float]:
        """Return p50, p99 and max of the recent lateness, s; zeros before the first paced tick."""
        recent = self._recent[: min(self._paced, _RECENT)]
        if not len(recent):
            return {"p50_s": 0.0, "p99_s": 0.0, "max_s": 0.0}
        p50, p99 = np.percentile(recent, (50, 99)).tolist()
        return {"p50_s": p50, "p99_s": p99, "max_s": float(recent.max())}
