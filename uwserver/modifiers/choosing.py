"""Chooses the delivered samples that a client gets, in compiled code, directly from their rows.

A line is a receiver of one stream, with the rate at which it wants samples.
"""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.arrays import Array, IntArray
from uwserver.physics.kernel.deferred import entry
from uwserver.ports.decimation import ROUNDING_NS
from uwserver.ports.sample_batch import SampleBatch

NOBODY, UNKNOWN = -1, -2
"""Instead of the number of a line: the stream has no line; it is not known yet whether the stream has one."""
NOT_BEGUN = -1
"""Instead of the start time of the intervals of a line."""


class NotMet(Exception):
    """A sample is the first of its stream: its line, or the start time of the intervals, is not known yet."""


@entry
def choose_samples(
    table: Array, first: int, end: int, lines: Array, ready: Array, rates: Array, starts: Array, newest: Array, chosen: Array
) -> int:  # fmt: skip
    """Choose samples as `choose` does.

    Returns:
        0; UNKNOWN, where `choose` raises NotMet; or NOBODY, where it returns None.
    """
    state = 0
    for place in range(first, end):
        stream = table[place, 2]
        line = lines[stream] if stream < len(lines) else UNKNOWN
        if line == UNKNOWN or (line != NOBODY and starts[line] == NOT_BEGUN):
            return UNKNOWN
        if line == NOBODY or not ready[line]:
            state = NOBODY  # a later sample may still be UNKNOWN, which comes first
    if state == NOBODY:
        return NOBODY
    for place in range(first, end):
        line, t_ns = lines[table[place, 2]], table[place, 4]
        if rates[line] > 0.0:
            interval = int((t_ns - starts[line] + ROUNDING_NS) * rates[line] // 1e9)
            if interval <= newest[line]:
                if newest[line] - rates[line] - 1.0 > interval:  # the time was set back by more than a second
                    return NOBODY
                line = NOBODY
            else:
                newest[line] = interval
        chosen[place - first] = line
    return 0


def choose(
    batch: SampleBatch, lines: IntArray, ready: list[bool], rates: list[float], starts: list[int], newest: list[int]
) -> IntArray | None:
    """Choose the samples that are the first in an interval of their line (`Decimation.interval`).

    Args:
        batch: the samples.
        lines: number of the line of each stream, NOBODY or UNKNOWN.
        ready: whether each line can take samples now.
        rates: intervals per second of each line; 0 if it takes all samples.
        starts: start time of the first interval of each line, ns, or NOT_BEGUN.
        newest: number of the newest interval of each line of which a sample was chosen; updated in place.

    Returns:
        For each sample the number of its line, or NOBODY if it is not chosen. None if a stream has no line, a line is not ready, or the time was
        set back by more than a second; then `newest` is not changed.

    Raises:
        NotMet: a sample is the first of its stream; `newest` is not changed.
    """
    after, chosen = np.array(newest, np.int64), np.empty(len(batch), np.int64)
    state = choose_samples(
        batch.log.table, batch.first, batch.first + len(batch), lines, np.array(ready, np.bool_),
        np.array(rates, np.float64), np.array(starts, np.int64), after, chosen,
    )  # fmt: skip
    if state == UNKNOWN:
        raise NotMet
    if state == NOBODY:
        return None
    newest[:] = after.tolist()
    return chosen


def load() -> None:
    """Make the kernel ready, so that no sample waits for it: compile it, or load it from the cache."""
    none = np.zeros(0, np.int64)
    choose_samples.made().load(none.reshape(0, 7), 0, 0, none, np.zeros(0, np.bool_), np.zeros(0), none, none, none)
