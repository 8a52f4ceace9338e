"""Added mass beside a plane against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.near_boundary import growth
from uwserver.physics.dynamics.params import BodyParams, NearBoundary
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NEAR_CYLINDER, NEAR_SPHERE

ZERO = np.zeros((6, 6))
M_A = np.diag([5.0, 20.0, 25.0, 0.3, 4.0, 4.5])
A = 0.2


def body(form: int = NEAR_SPHERE) -> BodyParams:
    return BodyParams(
        np.diag([30.0] * 3 + [2.0] * 3), M_A, ZERO, ZERO, ZERO, 300.0, 300.0, (0.0,) * 3, (0.0, 0.0, 0.0),
        near=NearBoundary(form, A),
    )  # fmt: skip


def world(params: BodyParams, z: float, floor: float = math.inf, dt: float = 0.005) -> Hydrodynamics:
    hydro = Hydrodynamics((), dt)
    hydro.floor = floor
    hydro.add(params)
    hydro.state[0, 2] = z
    return hydro


@pytest.mark.parametrize("height", [1.02, 1.2, 2.0, 5.0])
def test_a_cylinder_at_a_wall_has_the_series_in_bipolar_coordinates(height: float) -> None:
    """M / (rho pi a^2) = 1 + 4 sinh^2 alpha sum n exp(-3 n alpha) / sinh(n alpha), cosh alpha = h / a: found without images."""
    alpha = math.acosh(height)
    series = (
        4.0 * math.sinh(alpha) ** 2 * sum(n * math.exp(-3 * n * alpha) / math.sinh(n * alpha) for n in range(1, 150))
    )
    assert growth(NEAR_CYLINDER, height, 1.0) == pytest.approx((series, series), rel=1e-6)


def test_known_values_at_a_wall_and_far_away() -> None:
    """Touching: pi^2/3 - 1 of a cylinder, (3 zeta(3) - 1) / 2 of a ball over 1/2; far away the first image of each."""
    assert 1.0 + growth(NEAR_CYLINDER, 1.0, 1.0)[0] == pytest.approx(math.pi**2 / 3.0 - 1.0, abs=6e-3)
    assert 1.0 + growth(NEAR_SPHERE, 1.0, 1.0)[1] == pytest.approx(3.0 * 1.2020569 - 2.0, abs=1e-4)
    for sign in (1.0, -1.0):
        assert growth(NEAR_CYLINDER, 9.0, sign)[0] == pytest.approx(sign / (2.0 * 81.0), rel=1e-2)
        assert growth(NEAR_SPHERE, 9.0, sign) == pytest.approx((sign * 3 / 16 / 729, sign * 3 / 8 / 729), rel=1e-2)
    assert growth(NEAR_SPHERE, 0.3, -1.0) == growth(NEAR_SPHERE, 1.0, -1.0)


def masses(hydro: Hydrodynamics) -> FloatArray:
    """Inertia of each axis of B, from the acceleration by a unit wrench."""
    found = []
    for i in range(6):
        hydro.wrenches["bias"] = np.eye(6)[i]
        found.append(1.0 / hydro.rates_of_change(0.0)[0][0, i])
    return np.array(found) - np.diag(hydro.params[0].M_RB)


@pytest.mark.parametrize(("z", "floor"), [(0.3, math.inf), (9.7, 10.0), (0.3, 0.6)])
def test_surface_and_bottom_change_the_axes_of_the_form(z: float, floor: float) -> None:
    for form in (NEAR_CYLINDER, NEAR_SPHERE):
        along, square = 1.0, 1.0
        for height, sign in ((z, -1.0), (floor - z, 1.0)):
            if height < math.inf:
                more = growth(form, height / A, sign)
                along, square = along + more[0], square + more[1]
        factors = (1, along, along, 1, along, along) if form == NEAR_CYLINDER else (along, along, square, 1, 1, 1)
        np.testing.assert_allclose(masses(world(body(form), z, floor)), np.diag(M_A) * factors, rtol=1e-9)


def test_who_does_not_ask_for_it_has_none_and_deep_down_nobody_has() -> None:
    plain = world(replace(body(), near=NearBoundary()), 0.3, 0.6)
    np.testing.assert_allclose(masses(plain), np.diag(M_A), rtol=1e-12)
    np.testing.assert_allclose(masses(world(body(), 500.0, 1000.0)), np.diag(M_A), rtol=1e-8)


def test_what_moves_along_the_bottom_is_drawn_to_it() -> None:
    """Lagrange: (m + M_33) w' = u^2 dM_11/dz / 2 for a ball that moves level; dM_11/dz = 9/16 M a^3 / h^4."""
    hydro, h, u = world(body(), 9.6, 10.0), 0.4, 2.0
    hydro.state[0, 7] = u
    nu_dot, _ = hydro.rates_of_change(0.0)
    mass = 30.0 + M_A[2, 2] * (1.0 + growth(NEAR_SPHERE, h / A, 1.0)[1] + growth(NEAR_SPHERE, 9.6 / A, -1.0)[1])
    assert nu_dot[0, 2] * mass == pytest.approx(0.5 * u**2 * M_A[0, 0] * 9 / 16 * A**3 / h**4, rel=1e-3)


@pytest.mark.parametrize("form", [NEAR_SPHERE, NEAR_CYLINDER])
def test_no_energy_comes_from_the_bottom(form: int) -> None:
    """A neutral body without damping glides down to the bottom: what the growing mass takes up, its speed loses."""
    hydro = world(body(form), 9.2, 10.0, 1.0 / 240.0)
    hydro.state[0, 7:10] = 0.5, 0.3, 0.4
    energies = []
    for n in range(330):
        nu = hydro.state[0, 7:]
        energies.append(0.5 * np.sum(nu**2 * (masses_at(form, hydro.state[0, 2]) + np.diag(hydro.params[0].M_RB))))
        hydro.advance(n / 240.0)
    assert hydro.state[0, 2] > 9.65
    assert energies[-1] == pytest.approx(energies[0], rel=1e-5)


def masses_at(form: int, z: float) -> FloatArray:
    (s0, s1), (b0, b1) = growth(form, z / A, -1.0), growth(form, (10.0 - z) / A, 1.0)
    along, square = 1.0 + s0 + b0, 1.0 + s1 + b1
    factors = (1, along, along, 1, along, along) if form == NEAR_CYLINDER else (along, along, square, 1, 1, 1)
    return np.diag(M_A) * factors
