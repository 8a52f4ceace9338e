"""Ticks and their times: no drift, and a told time leads back to its own tick."""

from __future__ import annotations

from fractions import Fraction

import pytest

from uwserver.units import NANOSECONDS
from uwserver.world.stepping.step_table import Ticks

RATES = ("240", "250", "1000", "333", "333.3", "1200", "0.5")


@pytest.mark.parametrize("rate", RATES)
def test_time_is_computed_from_the_tick_and_never_drifts(rate: str) -> None:
    ticks = Ticks(Fraction(rate))
    for tick in (0, 1, 7, 239, 10**6, 3600 * 24 * 1200):
        exact = Fraction(tick * NANOSECONDS) / Fraction(rate)
        assert abs(ticks.time_of(tick) - exact) <= Fraction(1, 2)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("stride", [997, pytest.param(1, marks=pytest.mark.slow)])
def test_a_told_time_leads_back_to_its_tick(rate: str, stride: int) -> None:
    """As nanoseconds and as seconds, by a division or by a factor, for a million ticks."""
    ticks = Ticks(Fraction(rate))
    for tick in (*range(1000), *range(1000, 10**6, stride)):
        t_ns = ticks.time_of(tick)
        assert ticks.first_at(t_ns) == tick
        assert ticks.at(t_ns / 1e9) == tick, "what a status tells"
        assert ticks.at(t_ns * 1e-9) == tick, "what a client makes of t_ns"
        assert ticks.at(float(tick / Fraction(rate))) == tick, "the exact time, as near as a float comes"


@pytest.mark.parametrize("rate", RATES)
def test_a_time_between_two_ticks_is_the_later_ones(rate: str) -> None:
    ticks = Ticks(Fraction(rate))
    for tick in (0, 1, 2, 3, 10**6 - 1):
        t_ns = ticks.time_of(tick)
        assert ticks.first_at(t_ns + 1) == tick + 1
        assert ticks.first_at(t_ns - 1) == tick
        assert ticks.at((t_ns + 3) / 1e9) == tick + 1, "two nanoseconds are no rounding"


def test_after_years_floats_are_coarser_than_nanoseconds_and_still_lead_back() -> None:
    ticks = Ticks(Fraction(240))
    for tick in range(10**9 * 240 - 50, 10**9 * 240):
        assert ticks.at(ticks.time_of(tick) / 1e9) == tick
