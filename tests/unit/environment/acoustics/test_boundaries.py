"""Reflection against closed forms: normal incidence, the critical angle, the angle of intromission, and Eckart's rough surface."""

from __future__ import annotations

import math

import pytest

from uwserver.environment.acoustics.boundaries import SEDIMENTS, Sediment, bottom_loss, sediments, surface_loss


def test_normal_incidence_compares_impedances():
    """R = (rho c - rho' c') / (rho c + rho' c')."""
    for density, speed in ((1.9, 1.1), (1.5, 0.98), (7.7, 3.9)):
        z = density * speed
        expected = -20.0 * math.log10((z - 1.0) / (z + 1.0))
        assert bottom_loss(0.5 * math.pi, Sediment(density, speed, 0.0)) == pytest.approx(expected, rel=1e-12)


def test_all_is_reflected_below_the_critical_angle():
    sand = Sediment(1.9, 1.1, 0.0)
    critical = math.acos(1.0 / 1.1)
    assert bottom_loss(0.99 * critical, sand) == pytest.approx(0.0, abs=1e-9)
    assert bottom_loss(1.05 * critical, sand) > 2.0
    assert 0.0 < bottom_loss(0.5 * critical, SEDIMENTS["sand"]) < 2.0  # it takes something with it


def test_nothing_is_reflected_at_the_angle_of_intromission():
    """cos^2 = (m^2 - n^2) / (m^2 - 1) for a slow, heavy bottom; m ratio of densities, n index."""
    m, n = 1.5, 1.0 / 0.97
    angle = math.acos(math.sqrt((m * m - n * n) / (m * m - 1.0)))
    assert bottom_loss(angle, Sediment(m, 0.97, 0.0)) > 200.0
    assert bottom_loss(0.3 * angle, Sediment(m, 0.97, 0.0)) < 20.0


def test_attenuation_of_a_bottom_that_is_all_else_like_water():
    """Weakly absorbing water under water: |R| = delta / (2 sin^2) with the loss tangent delta = dB per wavelength / 54.6."""
    delta = 0.1 / (40.0 * math.pi * math.log10(math.e))
    for angle in (0.5, 1.0, 1.5):
        expected = -20.0 * math.log10(delta / (2.0 * math.sin(angle) ** 2))
        assert bottom_loss(angle, Sediment(1.0, 1.0, 0.1)) == pytest.approx(expected, abs=0.05)


def test_a_rough_surface_loses_its_mirror():
    """exp(-2 (k sigma sin)^2) of the pressure; nothing where it is smooth or grazed."""
    k, sigma, angle = 109.0, 0.01, 0.4
    assert 10.0 ** (-surface_loss(angle, sigma, k) / 20.0) == pytest.approx(
        math.exp(-2.0 * (k * sigma * math.sin(angle)) ** 2)
    )
    assert surface_loss(angle, 0.0, k) == 0.0
    assert surface_loss(0.0, 1.0, k) == 0.0
    assert surface_loss(angle, 1.0, k) == 300.0  # of no meaning, but a number


def test_an_unknown_material_is_taken_for_sediment():
    assert sediments(["sand", "porridge"]) == (SEDIMENTS["sand"], SEDIMENTS["sediment"])
    assert sediments([]) == (SEDIMENTS["sediment"],)
