"""The search for velocities at which water feeds a body, on bodies of which it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uwserver.physics.dynamics.appendage_params import Appendages, DerivativeParams
from uwserver.physics.dynamics.params import BodyParams
from uwserver.validation.energy import WaterPower, feeds, largest_feed

ZERO = np.zeros((6, 6))
MASS = np.diag([10.0, 10.0, 10.0, 1.0, 1.0, 1.0])
BODY = BodyParams(MASS, MASS, ZERO, ZERO, ZERO, 100.0, 120.0, (0.0, 0.0, 0.1), (0.0,) * 3)


def with_term(coefficient: float, quadratic: float = 0.0) -> BodyParams:
    """Z = c u w: power c u w^2, beside a drag of so much in surge and heave."""
    term = DerivativeParams(2, 0, 2, coefficient)
    D_Q = np.diag([quadratic, 0.0, quadratic, 0.0, 0.0, 0.0])
    return replace(BODY, D_Q=D_Q, appendages=Appendages(derivatives=(term,)))


def test_power_is_that_of_the_forces_without_coriolis_weight_and_buoyancy() -> None:
    water = WaterPower(replace(with_term(3.0), D_L=2.0 * np.eye(6)), 2)
    nu = np.array([[1.0, 0.5, 2.0, 0.1, -0.2, 0.3], [-1.0, 0.0, 2.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(water(nu), 3.0 * nu[:, 0] * nu[:, 2] ** 2 - 2.0 * (nu**2).sum(axis=1), rtol=1e-12)


def test_velocities_have_the_energy_asked_for() -> None:
    water = WaterPower(BODY, 1)
    nu = water.velocities(np.random.default_rng(1).normal(size=(7, 6)), 2.0)
    np.testing.assert_allclose(0.5 * np.einsum("ni,ij,nj->n", nu, 2.0 * MASS, nu), water.energy(2.0), rtol=1e-12)
    assert water.energy(2.0) == pytest.approx(40.0)


def test_linear_damping_takes_everywhere() -> None:
    """-d |nu|^2 over m |nu|^2 / 2, at its least in the heavy axes."""
    assert largest_feed(replace(BODY, D_L=np.eye(6)), 1.0).rate == pytest.approx(-0.1, rel=1e-3)


def test_the_worst_velocity_of_a_term_is_found() -> None:
    """c u w^2 on u^2 + w^2 = V^2 is largest at u^2 = V^2 / 3: 2 c V^3 / 3 sqrt 3."""
    found = largest_feed(with_term(-5.0), 2.0)
    assert found.rate * 40.0 == pytest.approx(2.0 * 5.0 * 8.0 / (3.0 * 3.0**0.5), rel=1e-2)
    assert found.nu[0] == pytest.approx(-2.0 / 3.0**0.5, abs=0.1)


def test_enough_damping_makes_a_term_harmless_at_every_speed() -> None:
    assert all(feed.rate > 0.0 for feed in feeds(with_term(-5.0)))
    assert all(feed.rate < 0.0 for feed in feeds(replace(with_term(-5.0, 10.0), D_L=0.1 * np.eye(6))))
