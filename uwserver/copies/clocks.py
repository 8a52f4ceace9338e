"""The clocks of copies, each by its own count of ticks, as a world has them."""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.world.ticks import Ticks

_MOST_DEN = 1 << 20
"""Of a rate num / den: with more, den times the ticks of some months is no exact float any more."""


class Clocks(NamedTuple):
    """The time of each copy: (n) ticks, and what they come to in s and ns; `rests`: of the latter, in parts of 1 / (2 num) ns (`kernels.tick`)."""

    ticks: IntArray
    ts: FloatArray
    t_ns: IntArray
    rests: IntArray


def clocks_of(n: int) -> Clocks:
    """Of n copies; `start` sets them."""
    return Clocks(np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.int64), np.zeros(n, np.int64))


def start(which: IntArray, clocks: Clocks, rate: Fraction) -> None:
    """It is t = 0 for these copies."""
    for clock in clocks[:3]:
        clock[which] = 0
    clocks.rests[which] = rate.numerator  # half a nanosecond: times are rounded half up


def carry_on(which: IntArray, clocks: Clocks, rate: Fraction) -> None:
    """Carry these clocks on by a tick, at a rate in Hz: exactly to what `world.ticks` and a world's seconds come to."""
    num, den = rate.numerator, rate.denominator
    if den <= _MOST_DEN:
        from uwserver.copies import kernels

        kernels.tick(which, clocks, num, den)
        return
    time_of = Ticks(rate).time_of
    clocks.ticks[which] += 1
    ticks = clocks.ticks[which]
    for tick in np.unique(ticks).tolist():
        here = which[ticks == tick]
        clocks.ts[here], clocks.t_ns[here] = tick * den / num, time_of(tick)
