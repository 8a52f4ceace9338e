"""Decimation of samples for slow readers: one sample in each of equal intervals."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct

ROUNDING_NS = 1000
"""Margin for sample times, which are rounded to whole nanoseconds: the first sample of an interval may seem to lie just before it."""


class Decimation(Struct, frozen=True, gc=False):
    """Rule that takes the first sample of a port in each interval. Intervals are computed, not accumulated, so they do not drift.

    Attributes:
        rate_hz: intervals per second.
        start_ns: start of the first interval: time of measurement of the first sample.
    """

    rate_hz: float
    start_ns: int

    def interval(self, t_ns: int) -> int:
        """Return the interval, counted from 0, of a sample that was measured at `t_ns`.

        `uwserver.step.delivery` computes the same numbers, to the last bit.
        """
        return int((t_ns - self.start_ns + ROUNDING_NS) * self.rate_hz // 1e9)


Decimations = Mapping[str, Collection[Decimation]]
"""Decimations by port path: only samples that one of them takes are needed. All samples of other ports are needed."""
EVERY_SAMPLE: Decimations = {}
"""No decimation: all samples are needed."""
