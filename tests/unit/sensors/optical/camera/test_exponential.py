"""The quick exponential: as near as light needs it, everywhere."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from uwserver.sensors.optical.camera.exponential import exponential


def test_it_is_the_exponential_within_a_hundred_millionth() -> None:
    for x in (*np.linspace(-32.0, 32.0, 4001), -1e-9, 0.0, 1e-9, 100.0):
        assert abs(exponential(float(x)) / math.exp(x) - 1.0) < 1e-8, x


def test_it_never_rises_on_the_way_down() -> None:
    """A step up between two places of the table would be a ring in the water."""
    values = [exponential(-0.0005 * k) for k in range(4000)]
    assert all(a > b for a, b in pairwise(values))


def test_far_away_is_nothing_and_what_is_no_number_is_dark() -> None:
    assert [exponential(x) for x in (-32.001, -1e9, -math.inf, math.nan)] == [0.0] * 4
