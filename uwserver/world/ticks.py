"""Ticks and their times, in whole numbers: there and back without a drift."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TypeVar

from uwserver.physics.kernel.arrays import IntArray
from uwserver.units import NANOSECONDS

Number = TypeVar("Number", int, IntArray)


class Ticks:
    """The grid of times on which a world moves."""

    def __init__(self, rate_hz: Fraction) -> None:
        """Of a world with this physics rate, Hz (> 0)."""
        # In whole numbers, as Fraction arithmetic would cost as much as a sensor.
        self._double_ns, self._rate = 2 * NANOSECONDS * rate_hz.denominator, rate_hz.numerator

    def time_of(self, tick: Number) -> Number:
        """Simulation time of a tick, or of an array of some, ns (half up): computed from its number, never accumulated."""
        return (tick * self._double_ns + self._rate) // (2 * self._rate)

    def first_at(self, t_ns: int) -> int:
        """The first tick whose time is t_ns (ns) or later."""
        return -((self._rate - 2 * self._rate * t_ns) // self._double_ns)

    def at(self, t_s: float) -> int:
        """The first tick at simulation time t_s (s, finite, >= 0) or later.

        1 ns earlier is as good: told times are whole nanoseconds, and a float that was made of one is not quite it. So the time that a status tells
        leads back to its own tick. (After 97 days floats are coarser than that; then two of their steps are.)
        """
        slack_ns = max(1, math.ceil(2 * math.ulp(t_s) * NANOSECONDS))
        return max(0, self.first_at(round(t_s * NANOSECONDS) - slack_ns))
