"""The times of ticks, in whole numbers, so that conversion in both directions is exact."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TypeVar

from uwserver.physics.kernel.arrays import IntArray
from uwserver.units import NANOSECONDS

Number = TypeVar("Number", int, IntArray)


class Ticks:
    """The times at which a world stands."""

    def __init__(self, rate_hz: Fraction) -> None:
        """Take the number of ticks per second, Hz (> 0)."""
        # As integers, because arithmetic with Fractions would take as long as a sensor.
        self._parts, self._rate = rate_hz.denominator, rate_hz.numerator
        self._double_ns = 2 * NANOSECONDS * self._parts

    def time_of(self, tick: Number) -> Number:
        """Return the simulation time of a tick, or of an array of ticks, ns (rounded half up). It is computed from the number of the tick,
        never accumulated."""
        return (tick * self._double_ns + self._rate) // (2 * self._rate)

    def second(self, tick: int) -> float:
        """Return the simulation time of a tick, s."""
        return tick * self._parts / self._rate

    def first_at(self, t_ns: int) -> int:
        """Return the first tick whose time is t_ns (ns) or later."""
        return -((self._rate - 2 * self._rate * t_ns) // self._double_ns)

    def at(self, t_s: float) -> int:
        """Return the first tick at simulation time t_s (s, finite, >= 0) or later.

        A tick 1 ns earlier also counts: reported times are whole nanoseconds, and a float made of one is not exact. So the time in a status
        leads back to its own tick. (After 97 days, floats are coarser than 1 ns; then a tick two steps of a float earlier counts.)
        """
        slack_ns = max(1, math.ceil(2 * math.ulp(t_s) * NANOSECONDS))
        return max(0, self.first_at(round(t_s * NANOSECONDS) - slack_ns))
