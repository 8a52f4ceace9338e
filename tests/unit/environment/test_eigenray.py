"""Rays of a layered sea: closed forms for constant speed and constant gradient, Snell's law, Fermat's principle, an integrated ray."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from uwserver.environment.eigenray import eigenray, straight

GRID = np.arange(0.0, 2001.0, 5.0)


@pytest.mark.parametrize(
    ("x", "a", "b"),
    [(0.0, 10.0, 500.0), (300.0, 10.0, 410.0), (1000.0, 50.0, 50.0), (800.0, 900.0, 100.0), (3e3, 5.0, 6.0)],
)
def test_constant_speed_is_straight(x, a, b):
    speed = np.full(GRID.shape, 1480.0)
    for path in (eigenray(GRID, speed, x, a, b), straight(GRID, speed, x, a, b)):
        assert path.time == pytest.approx(math.hypot(x, b - a) / 1480.0, rel=1e-13)
        assert (path.dip_a, path.dip_b) == pytest.approx((math.atan2(b - a, x),) * 2, abs=1e-9)


@pytest.mark.parametrize("gradient", [0.017, -0.05, 0.3])
@pytest.mark.parametrize(
    ("x", "a", "b"),
    [
        (0.0, 10.0, 500.0),
        (300.0, 10.0, 410.0),
        (2000.0, 900.0, 100.0),
        (1500.0, 100.0, 100.0),
        (40.0, 3.0, 1800.0),
        (5000.0, 200.0, 230.0),
    ],
)
def test_constant_gradient_in_closed_form(gradient, x, a, b):
    """t = acosh(1 + g^2 d^2 / (2 c_a c_b)) / |g|, the arc of a circle; also where it turns."""
    speed = 1500.0 + gradient * GRID
    c_a, c_b = 1500.0 + gradient * a, 1500.0 + gradient * b
    path = eigenray(GRID, speed, x, a, b)
    expected = 2.0 * math.asinh(abs(gradient) * math.sqrt((x * x + (b - a) ** 2) / (c_a * c_b)) / 2.0) / abs(gradient)
    assert path.time == pytest.approx(expected, rel=1e-10)
    assert math.cos(path.dip_a) / c_a == pytest.approx(math.cos(path.dip_b) / c_b, rel=1e-7, abs=1e-12)  # Snell
    assert path.time <= straight(GRID, speed, x, a, b).time * (1.0 + 1e-12)  # Fermat


@pytest.mark.parametrize(("x", "a", "b"), [(600.0, 5.0, 800.0), (600.0, 800.0, 5.0), (2500.0, 20.0, 1500.0)])
def test_a_thermocline_against_an_integrated_ray(x, a, b):
    """The ray equations, integrated from a with the dip that was found, arrive at b in the time that was found."""
    speed = 1490.0 + 20.0 / (1.0 + np.exp((GRID - 60.0) / 15.0)) + 0.016 * GRID
    path = eigenray(GRID, speed, x, a, b)
    sign = 1.0 if b > a else -1.0
    p = math.cos(path.dip_a) / np.interp(a, GRID, speed)

    def motion(z, _):
        c = np.interp(z, GRID, speed)
        sine = math.sqrt(1.0 - (p * c) ** 2)
        return [p * c / sine, 1.0 / (c * sine)]

    way = solve_ivp(motion, (min(a, b), max(a, b)), [0.0, 0.0], rtol=1e-10, atol=1e-12, max_step=5.0).y[:, -1]
    assert way[0] == pytest.approx(x, abs=1e-4)
    assert way[1] == pytest.approx(path.time, rel=1e-7)
    assert path.dip_a * sign > 0.0
    assert path.time < straight(GRID, speed, x, a, b).time


def test_there_and_back_takes_the_same_time():
    speed = 1490.0 + 20.0 * np.exp(-GRID / 100.0)
    there, back = eigenray(GRID, speed, 700.0, 10.0, 300.0), eigenray(GRID, speed, 700.0, 300.0, 10.0)
    assert there.time == pytest.approx(back.time, rel=1e-13)
    assert (there.dip_a, there.dip_b) == pytest.approx((-back.dip_b, -back.dip_a))
