"""Verdicts and quantiles: what turns raw times into a judgement."""

from __future__ import annotations

import pytest
from uwserver_bench.rows import Row, quantile


def row(*values: float, **bars: float) -> Row:
    return Row("physics", "a case", "ms", values, **bars)


def test_the_median_is_judged_not_the_best_or_the_mean() -> None:
    assert row(1.0, 9.0, 100.0).value == 9.0
    assert row(1.0, 9.0, 100.0, at_most=10.0).verdict == "ok"
    assert row(1.0, 11.0, 2.0, at_least=5.0).verdict == "miss"


@pytest.mark.parametrize(("value", "verdict"), [(9.9, "miss"), (10.0, "ok"), (10.1, "ok")])
def test_at_least_includes_the_bar(value: float, verdict: str) -> None:
    assert row(value, at_least=10.0).verdict == verdict


@pytest.mark.parametrize(("value", "verdict"), [(9.9, "ok"), (10.0, "ok"), (10.1, "miss")])
def test_at_most_includes_the_bar(value: float, verdict: str) -> None:
    assert row(value, at_most=10.0).verdict == verdict


def test_without_a_bar_it_informs_and_without_values_it_is_absent() -> None:
    assert row(1.0).verdict == "info"
    assert row(at_least=1.0).verdict == "absent"
    assert row().value is None


@pytest.mark.parametrize(("part", "expected"), [(0.0, 1), (0.5, 50), (0.99, 99), (0.991, 100), (1.0, 100)])
def test_quantile_is_the_smallest_value_that_covers_the_part(part: float, expected: int) -> None:
    assert quantile(range(100, 0, -1), part) == expected


def test_quantile_of_one_value_is_that_value() -> None:
    assert quantile([7.0], 0.99) == 7.0
