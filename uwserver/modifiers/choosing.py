"""Which delivered samples are sent, chosen by compiled code from the rows in which they lie, where each stream has one who takes it, at his rate."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.arrays import Array, IntArray
from uwserver.physics.kernel.deferred import entry
from uwserver.ports.thinning import ROUNDING_NS
from uwserver.ports.told import Told

NOBODY, UNKNOWN = -1, -2
"""Instead of the number of a line: there is none; nobody has looked for one yet."""
NOT_BEGUN = -1
"""Instead of the time at which intervals begin."""


class NotMet(Exception):
    """A sample is the first of its stream: nobody has said whether that has a line, or when its intervals begin."""


@entry
def choose_samples(
    table: Array, first: int, end: int, lines: Array, ready: Array, rates: Array, starts: Array, newest: Array, chosen: Array
) -> int:  # fmt: skip
    """Choose, as `choose`. Returns 0; or UNKNOWN, or NOBODY where it is not as it must be."""
    state = 0
    for place in range(first, end):
        stream = table[place, 2]
        line = lines[stream] if stream < len(lines) else UNKNOWN
        if line == UNKNOWN or (line != NOBODY and starts[line] == NOT_BEGUN):
            return UNKNOWN
        if line == NOBODY or not ready[line]:
            state = NOBODY
    if state == NOBODY:
        return NOBODY
    for place in range(first, end):
        line, t_ns = lines[table[place, 2]], table[place, 4]
        if rates[line] > 0.0:
            interval = int((t_ns - starts[line] + ROUNDING_NS) * rates[line] // 1e9)
            if interval <= newest[line]:
                if newest[line] - rates[line] - 1.0 > interval:
                    return NOBODY
                line = NOBODY
            else:
                newest[line] = interval
        chosen[place - first] = line
    return 0


def choose(
    told: Told, lines: IntArray, ready: list[bool], rates: list[float], starts: list[int], newest: list[int]
) -> IntArray | None:
    """Choose of these samples those that are the first in an interval of their line, as `Thinning.interval` counts them.

    Args:
        told: the samples.
        lines: by number of a stream, that of its line.
        ready: of each line, whether it takes samples now.
        rates: of each, intervals a second; 0 where it takes all.
        starts: of each, when the first interval begins, ns, or NOT_BEGUN.
        newest: of each, the last interval of which a sample was chosen. Becomes what it is behind these.

    Returns:
        Of each sample the number of its line, or NOBODY where it is not chosen. None, and nothing is changed, where a stream has no line, a line
        is not ready, or the time was set back by more than a second.

    Raises:
        NotMet: see there; nothing is changed.
    """
    behind, chosen = np.array(newest, np.int64), np.empty(len(told), np.int64)
    state = choose_samples(
        told.log.table, told.first, told.first + len(told), lines, np.array(ready, np.bool_),
        np.array(rates, np.float64), np.array(starts, np.int64), behind, chosen,
    )  # fmt: skip
    if state == UNKNOWN:
        raise NotMet
    if state == NOBODY:
        return None
    newest[:] = behind.tolist()
    return chosen


def load() -> None:
    """Have it ready, compiled or from the cache, so that nobody who waits for a sample waits for it."""
    none = np.zeros(0, np.int64)
    choose_samples.made().load(none.reshape(0, 7), 0, 0, none, np.zeros(0, np.bool_), np.zeros(0), none, none, none)
