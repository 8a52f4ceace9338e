"""How late the ticks are, and how fast simulation time goes: counted by the simulation thread, read by anybody."""

from __future__ import annotations

import numpy as np

BUCKETS_S = (1e-5, 2.5e-5, 5e-5, 1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 1e-2, 2.5e-2, 5e-2, 0.1, 0.25)
"""Upper bounds of the histogram, s."""

_RECENT = 8192


class Lateness:
    """Histogram over the whole run and quantiles over the last 8192 paced ticks.

    Attributes:
        ticks: all ticks done.
        counts: paced ticks in each bucket, the last without bound.
        total_s: sum of all lateness.
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
        k = 0
        while k < len(BUCKETS_S) and late > BUCKETS_S[k]:
            k += 1
        self.counts[k] += 1
        self.total_s += late
        self._recent[self._paced % _RECENT] = late
        self._paced += 1

    def quantiles(self) -> dict[str, float]:
        """p50, p99 and max of the recent lateness, s; zeros before the first paced tick."""
        recent = self._recent[: min(self._paced, _RECENT)]
        if not len(recent):
            return {"p50_s": 0.0, "p99_s": 0.0, "max_s": 0.0}
        p50, p99 = np.percentile(recent, (50, 99)).tolist()
        return {"p50_s": p50, "p99_s": p99, "max_s": float(recent.max())}
