"""The interval of a median: against the tables of the sign test, and against how often it really holds the median."""

from __future__ import annotations

import numpy as np
import pytest
from uwserver_bench.against.intervals import median_interval


@pytest.mark.parametrize(
    ("count", "first"), [(6, 1), (8, 1), (9, 2), (11, 2), (12, 3), (15, 4), (16, 4), (17, 5), (20, 6), (30, 10), (100, 40)]
)  # fmt: skip
def test_it_is_the_pair_of_order_statistics_of_the_tables(count: int, first: int) -> None:
    """Conover (1999), table A3 of the binomial distribution with p = 1/2: the most that may be cut from each end at 95 %."""
    assert median_interval(range(count, 0, -1)) == (first, count + 1 - first)


@pytest.mark.parametrize("count", range(6))
def test_too_few_values_have_none(count: int) -> None:
    assert median_interval([1.0] * count) is None


def test_less_confidence_is_narrower_and_needs_fewer_values() -> None:
    assert median_interval(range(1, 16), 0.8) == (5, 11)
    assert median_interval(range(1, 6), 0.9) == (1, 5)


@pytest.mark.parametrize("count", [6, 15, 20])
def test_it_holds_the_median_of_a_skewed_distribution_as_often_as_it_says(count: int) -> None:
    draws = np.random.default_rng(1).exponential(size=(4000, count))
    held = [low <= np.log(2.0) <= high for low, high in map(median_interval, draws.tolist())]
    assert 0.945 < np.mean(held) < 0.985
