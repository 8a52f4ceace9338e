"""What is enough for who reads slowly: one sample in each of equal intervals."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct

ROUNDING_NS = 1000
"""Sample times are rounded to whole nanoseconds: one that belongs to an interval may seem to lie just before it."""


class Thinning(Struct, frozen=True, gc=False):
    """Of the samples of a port the first in each interval is taken. Intervals are computed, not accumulated, so they do not drift.

    Attributes:
        rate_hz: intervals a second.
        start_ns: where the first begins: when the first sample was true.
    """

    rate_hz: float
    start_ns: int

    def interval(self, t_ns: int) -> int:
        """In which interval, from 0, a sample lies that was true at `t_ns`.

        `uwserver.step.delivery` computes the same numbers, to the last bit.
        """
        return int((t_ns - self.start_ns + ROUNDING_NS) * self.rate_hz // 1e9)


Thinned = Mapping[str, Collection[Thinning]]
"""Of ports by path, of which no other samples are needed than those that one of these takes."""
WHOLE: Thinned = {}
"""Of no port: all samples are needed."""
