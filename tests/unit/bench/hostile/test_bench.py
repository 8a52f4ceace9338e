"""Late ticks: what of a delay is our own work, and what other processes took."""

from __future__ import annotations

import numpy as np
import pytest
from uwserver_bench.hostile.bench import TICK_NS, delay_of

MS = 1_000_000


def delays(*ticks: tuple[float, ...]) -> tuple[float, float, float]:
    """Of ticks that are so late, after so much work of the loop, and so much waiting for a processor, and so much work of the simulation, ms."""
    rows = [(*tick, 0.0)[:4] for tick in ticks]
    late, looped, waited, ticked = (np.cumsum([0.0, *column]) * MS for column in zip(*rows, strict=True))
    ends = 10**12 + TICK_NS * np.arange(len(late)) + late
    spent = np.stack((looped, waited, ticked), axis=1)
    order = np.argsort(-ends)  # a trace is a ring: no order is promised
    found = delay_of(ends[order].astype(np.int64), spent[order].astype(np.int64), 0, 2 * 10**12)
    return tuple(round(value, 3) for value in (found.gap - TICK_NS / MS, found.ours, found.others))  # type: ignore[return-value]


def test_what_the_loop_did_is_ours_and_waiting_for_a_processor_is_others() -> None:
    assert delays((0.0, 1.0, 0.0), (3.0, 2.5, 0.0), (0.0, 1.0, 0.0)) == (3.0, 2.5, 0.5)
    assert delays((8.0, 2.0, 7.0), (0.0, 0.0, 0.0)) == (8.0, 1.0, 7.0)
    assert delays((8.0, 2.0, 9.0), (1.5, 4.0, 0.0)) == (8.0, 1.5, 8.0), "the longest gap need not be our worst"


def test_what_a_tick_itself_carried_out_is_ours_too() -> None:
    usual = (0.0, 0.0, 0.0, 0.7)
    assert delays(usual, usual, (3.5, 0.5, 0.0, 3.2), (-3.5, 0.0, 0.0, 0.7), usual) == (3.5, 3.0, 0.5)


def test_a_server_that_stood_still_is_told_so() -> None:
    found = delay_of(np.zeros(8, np.int64), np.zeros((8, 3), np.int64), 10**9, 2 * 10**9)
    assert found == pytest.approx((1000.0, 1000.0, 0.0))
