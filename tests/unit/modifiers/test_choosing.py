"""Samples are chosen as `Decimation` counts intervals, stream by stream; or nothing is changed."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.modifiers.choosing import NOBODY, NOT_BEGUN, UNKNOWN, NotMet, choose
from uwserver.ports.decimation import Decimation
from uwserver.ports.sample_batch import SampleBatch, SampleLog
from uwserver.step.streams import ENTRY


def batch(samples: list[tuple[int, int]]) -> SampleBatch:
    """Samples of these streams, true at these times; the log begins with one of somebody else."""
    log = SampleLog(np.zeros(1 + len(samples), ENTRY), np.zeros(1))
    for place, (stream, t_ns) in enumerate(samples, 1):
        log.entries[place] = (t_ns, 0, stream, place, t_ns, 1, 0)
    return SampleBatch({}, log, 1, len(samples) + 1)


def test_each_line_takes_the_first_in_each_of_its_intervals() -> None:
    """The same as one by one, to the last bit, with times that lie just before a bound by rounding, and rates of all sizes."""
    rng = np.random.default_rng(4)
    rates = [0.0, 10.0, 7.3, 1e9, 120.0, 1e-3]
    samples = sorted(
        (int(t), int(k)) for t, k in zip(rng.integers(5, 10**10, 900), rng.integers(6, size=900), strict=True)
    )
    samples += [(round(n * 1e9 / 7.3) + 10**10, 2) for n in range(200)]
    lines = np.array([5, 4, 3, 2, 1, 0])
    starts, newest = [0, 3, 1, 0, 5, 2], [0, -1, 0, 7, 0, -1]
    wanted, last = [], [*newest]
    for t_ns, stream in samples:
        line = int(lines[stream])
        interval = Decimation(rates[line], starts[line]).interval(t_ns) if rates[line] else last[line] + 1
        wanted.append(line if interval > last[line] else NOBODY)
        last[line] = max(last[line], interval) if rates[line] else last[line]
    got = choose(batch([(k, t) for t, k in samples]), lines, [True] * 6, rates, starts, newest)
    assert got is not None
    assert got.tolist() == wanted
    assert newest == last
    assert 100 < sum(line != NOBODY for line in wanted) < 1100


@pytest.mark.parametrize(
    ("streams", "ready", "t_ns"),
    [((0, 1), (True, True), 10), ((0, 2), (False, True), 10), ((0, 2, 0), (True, True), -(10**10))],
    ids=["no line", "no time", "time set back"],
)
def test_where_it_cannot_nothing_is_changed(streams: tuple[int, ...], ready: tuple[bool, ...], t_ns: int) -> None:
    newest = [3, 5]
    samples = batch([(stream, 10**9 if n == 0 else t_ns) for n, stream in enumerate(streams)])
    assert choose(samples, np.array([0, NOBODY, 1]), [*ready], [10.0, 0.0], [0, 0], newest) is None
    assert newest == [3, 5]


def test_a_little_back_is_only_late() -> None:
    newest = [20]
    got = choose(batch([(0, 10**9), (0, 2 * 10**9 + 10**8)]), np.array([0]), [True], [10.0], [0], newest)
    assert got is not None
    assert (got.tolist(), newest) == ([NOBODY, 0], [21])


@pytest.mark.parametrize("lines", [[0], [0, UNKNOWN], [0, 1]], ids=["beyond all", "unknown", "not begun"])
def test_who_is_met_for_the_first_time_is_told(lines: list[int]) -> None:
    newest = [0, 0]
    with pytest.raises(NotMet):
        choose(batch([(0, 10**9), (1, 5)]), np.array(lines), [True, True], [1.0, 1.0], [0, NOT_BEGUN], newest)
    assert newest == [0, 0]
