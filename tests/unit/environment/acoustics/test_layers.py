"""A ray in single layers: nodes at their places, sums that do not depend on the number of layers, and the thinning of a profile."""

from __future__ import annotations

import math

import numpy as np
import pytest
from ray_rig import thermocline

from uwserver.environment.acoustics.layers import advance_slope, leg, medium, thin_out, widening

DEPTH = np.array([0.0, 40.0, 100.0, 300.0])
SPEED = np.array([1490.0, 1500.0, 1480.0, 1510.0])
NONE = np.zeros(4)


@pytest.mark.parametrize(
    ("a", "b", "bottom", "nodes", "ends"),
    [
        (10.0, 60.0, math.inf, [0.0, 10.0, 40.0, 60.0, 100.0, 300.0], (1, 3)),
        (40.0, 40.0, 200.0, [0.0, 40.0, 100.0, 200.0], (1, 1)),
        (0.0, 100.0, 100.0, [0.0, 40.0, 100.0], (0, 2)),
        (20.0, 350.0, 500.0, [0.0, 20.0, 40.0, 100.0, 300.0, 350.0, 500.0], (1, 5)),
        (39.9999999999, 350.0, math.inf, [0.0, 40.0, 100.0, 300.0, 350.0], (1, 4)),
    ],
)
def test_nodes(a, b, bottom, nodes, ends):
    m = medium(DEPTH, SPEED, NONE, a, b, bottom)
    assert m.z == pytest.approx(nodes)
    assert m.c == pytest.approx(np.interp(nodes, DEPTH, SPEED))
    assert ((m.upper, m.lower), m.closed) == (ends, math.isfinite(bottom))


@pytest.mark.parametrize("parts", [1, 7])
def test_a_layer_is_as_long_as_its_parts(parts):
    """Range, time and losses in a constant gradient, in closed form, in one piece or in many; turning too."""
    z = np.linspace(0.0, 100.0, parts + 1)
    g, p = 0.2, math.cos(0.3) / 1500.0
    m = medium(z, 1500.0 + g * z, np.full(z.shape, 0.01), 0.0, 0.0, math.inf)
    q = math.sin(0.3) ** 2
    far = math.sqrt(1.0 - (p * 1520.0) ** 2)
    whole = leg(m, p, q, 0, parts)
    assert whole.x == pytest.approx((math.sin(0.3) - far) / (p * g), rel=1e-12)
    assert whole.time == pytest.approx(math.log(1520.0 / 1500.0 * (1.0 + math.sin(0.3)) / (1.0 + far)) / g, rel=1e-12)
    assert whole.loss == pytest.approx(0.01 * (0.3 - math.acos(p * 1520.0)) / (p * g), rel=1e-7)
    h = 1e-6 * p
    sides = [(math.sqrt(1 - (s * 1500.0) ** 2) - math.sqrt(1 - (s * 1520.0) ** 2)) / (s * g) for s in (p - h, p + h)]
    assert advance_slope(m, p, q, 0, parts)[1] == pytest.approx((sides[1] - sides[0]) / (2.0 * h), rel=1e-6)
    q, p = math.sin(0.1) ** 2, math.cos(0.1) / 1500.0
    turning = leg(m, p, q, 0, parts)
    assert turning.turned
    assert turning.x == pytest.approx(math.sin(0.1) / (p * g), rel=1e-12)
    assert turning.time == pytest.approx(math.atanh(math.sin(0.1)) / g, rel=1e-12)
    assert widening(m, p, q, 0, parts) == (pytest.approx(-1.0 / (p * p * g * math.sin(0.1)), rel=1e-9), True)


def test_a_bend_of_the_profile_does_not_tear_the_tube():
    """Where a ray turns just beyond a node of a bending profile, the widening stays that of the bend; without care it is off by more than half."""
    z = np.arange(0.0, 100.5, 1.0)
    m = medium(z, 1480.0 + 0.002 * z * z, np.zeros(z.shape), 20.0, 20.0, math.inf)
    fine = np.arange(0.0, 100.0005, 0.001)
    smooth = medium(fine, 1480.0 + 0.002 * fine * fine, np.zeros(fine.shape), 20.0, 20.0, math.inf)
    worst = {True: 0.0, False: 0.0}
    for deep in (30.0001, 30.3, 30.9, 31.001):
        speed = 1480.0 + 0.002 * deep * deep
        theta = math.acos(m.c[m.upper] / speed)
        q, p = math.sin(theta) ** 2, math.cos(theta) / m.fastest
        exact = widening(smooth, p, q, smooth.upper, len(fine) - 1)[0]
        for careful, found in (
            (True, widening(m, p, q, m.upper, 100)[0]),
            (False, advance_slope(m, p, q, m.upper, 100)[1]),
        ):
            worst[careful] = max(worst[careful], abs(found / exact - 1.0))
    assert worst[True] < 0.02
    assert worst[False] > 0.5


def test_thinning_keeps_what_bends():
    grid = np.arange(0.0, 1000.0, 0.5)
    speed = thermocline(grid)[0]
    kept = thin_out(grid, speed, 1e-3)
    assert np.abs(np.interp(grid, grid[kept], speed[kept]) - speed).max() <= 1e-3
    assert 20 < len(kept) < 300
    assert list(thin_out(grid, 1500.0 + 0.016 * grid, 1e-3)) == [0, len(grid) - 1]
