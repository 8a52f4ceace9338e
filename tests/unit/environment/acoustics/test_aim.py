"""The angle at which a ray goes as far as asked: it gets there, and in few looks, also beside a ray that just turns."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.environment.acoustics import aim
from uwserver.environment.acoustics.fan import angle_of
from uwserver.environment.acoustics.layers import medium


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Angles that are looked at, as the search runs in Python."""
    seen: list[float] = []
    reach = aim.reach.py_func  # type: ignore[attr-defined]

    def counted(*args):
        seen.append(args[1])
        return reach(*args)

    monkeypatch.setattr(aim, "reach", counted)
    return seen


PROFILES = [
    ([0.0, 50.0, 60.0, 200.0], [1500.0, 1510.0, 1510.2, 1530.0]),
    ([0.0, 50.0, 60.0, 200.0], [1500.0, 1510.0, 1510.01, 1530.0]),
    ([0.0, 20.0, 40.0, 200.0], [1500.0, 1500.1, 1510.0, 1530.0]),
    ([0.0, 30.0, 31.0, 200.0], [1500.0, 1500.1, 1515.0, 1516.0]),
]
"""Gradients that change much from layer to layer, so that ways do between a ray that turns at one node and that which turns at the next."""


@pytest.mark.parametrize(("depth", "speed"), PROFILES)
def test_few_looks_find_the_angle(depth: list[float], speed: list[float], looks: list[float]) -> None:
    """For distances all over what rays between two neighbours reach. Where ways rise with the angle six looks are enough; all of them need nineteen
    at most."""
    m = medium(np.array(depth), np.array(speed), np.zeros(len(depth)), 10.0, 12.0, depth[-1])
    checked = 0
    for node in range(m.lower, len(m.c) - 1):
        low, high = max(angle_of(m.fastest, m.c[node]), 1e-30), angle_of(m.fastest, m.c[node + 1])
        flat, steep = (aim.reach(m, theta, 0, 1, 2)[0] for theta in (low * (1 + 1e-9), high * (1 - 1e-9)))
        for part in (0.02, 0.2, 0.5, 0.8, 0.98):
            x = flat + part * (steep - flat)
            looks.clear()
            theta = aim.solve.py_func(m, low, high, flat - x, steep - x, x, 0, 1, 2)
            number = len(looks)
            assert number <= (6 if steep > flat else 19)
            assert low < theta < high
            assert aim.reach(m, theta, 0, 1, 2)[0] == pytest.approx(x, abs=1e-6)
            checked += 1
    assert checked == 15


def test_no_angle_where_no_ray_goes_so_far() -> None:
    m = medium(np.array([0.0, 100.0]), np.array([1500.0, 1500.0]), np.zeros(2), 10.0, 40.0, 100.0)
    assert math.isnan(aim.turn(m, 0.1, 0.2, 1.0, 1e6, 0, 1, 0))
