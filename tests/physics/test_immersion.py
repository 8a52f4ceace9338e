"""Partly submerged shapes against closed forms and Monte Carlo, and bodies at the surface."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.closed_forms import floating, tilt
from uwserver_bench.proofs.motion import record

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.immersion import box_fraction, disc_fraction, sphere_fraction
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, SHAPE_BOX, SHAPE_SPHERE, Q

UP = np.array([0.0, 0.0, -1.0])


def unit(rng: np.random.Generator) -> FloatArray:
    v = rng.normal(size=3)
    result: FloatArray = v / np.linalg.norm(v)
    return result


@pytest.mark.parametrize("s", [-1.5, -1.0, -0.6, 0.0, 0.3, 0.999, 1.0, 2.0])
def test_sphere_against_the_cap(s: float) -> None:
    radius, offset = 0.7, np.empty(3)
    fraction = sphere_fraction(s * radius, radius, UP, offset)
    z = (
        np.linspace(max(-1.0, -s), 1.0, 20001) if s > -1.0 else np.array([1.0, 1.0])
    )  # layers below the water, down positive
    area = 1.0 - z**2
    volume = np.trapezoid(area, z)
    assert fraction == pytest.approx(volume / (4.0 / 3.0), abs=1e-7)
    if fraction > 0.0:
        assert offset[2] == pytest.approx(radius * np.trapezoid(area * z, z) / volume, abs=1e-6)
    assert offset[:2].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("s", [-1.2, -1.0, -0.5, 0.0, 0.5, 1.0, 1.2])
def test_level_box(s: float) -> None:
    half, offset = np.array([0.5, 0.3, 0.2]), np.empty(3)
    fraction = box_fraction(s * half[2], half, UP, offset)
    expected = min(1.0, max(0.0, 0.5 * (1.0 + s)))
    assert fraction == pytest.approx(expected, abs=1e-12)
    if 0.0 < expected < 1.0:
        np.testing.assert_allclose(offset, [0.0, 0.0, half[2] * (1.0 - expected)], atol=1e-12)


def test_box_balanced_on_an_edge_is_a_prism() -> None:
    """Roll of 45 degrees, hub at the surface: half the box, a triangle whose centroid lies a third of its height down."""
    half, offset = np.array([1.0, 0.25, 0.25]), np.empty(3)
    up = np.array([0.0, math.sqrt(0.5), -math.sqrt(0.5)])
    assert box_fraction(0.0, half, up, offset) == pytest.approx(0.5, abs=1e-12)
    assert offset @ up == pytest.approx(-0.25 * math.sqrt(2.0) / 3.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_tilted_box_against_monte_carlo(seed: int) -> None:
    rng = np.random.default_rng(seed)
    half, up = rng.uniform(0.1, 1.0, 3), unit(rng)
    depth = rng.uniform(-0.8, 0.8) * float(np.abs(up) @ half)
    points = rng.uniform(-1.0, 1.0, (200_000, 3)) * half
    below = points[points @ up <= depth]
    offset = np.empty(3)
    fraction = box_fraction(depth, half, up, offset)
    assert fraction == pytest.approx(len(below) / len(points), abs=5e-3)
    if len(below) > 2000:
        np.testing.assert_allclose(offset, below.mean(axis=0), atol=6.0 * half.max() / math.sqrt(len(below)))


def test_disc_against_a_sum_of_strips() -> None:
    radius = 0.038
    for s in (-1.2, -0.7, 0.0, 0.4, 0.95, 1.1):
        z = np.linspace(-1.0, 1.0, 40001)
        strips = np.sqrt(1.0 - z**2) * (z + s >= 0.0)
        assert disc_fraction(s * radius, radius) == pytest.approx(2.0 * np.trapezoid(strips, z) / math.pi, abs=1e-4)


@pytest.mark.parametrize("name", ["bluerov2", "bluerov2_heavy", "rexrov", "lauv", "eca_a9", "tethys"])
def test_a_vehicle_surfaces_and_settles_level(load_vehicle: Callable[..., BodyParams], name: str) -> None:
    body = load_vehicle(name)
    hydro = Hydrodynamics([body], 0.01)
    hydro.state[0, 2] = 1.5
    hydro.state[0, Q : Q + 4] = quat_from_rpy(0.2, -0.1, 0.5)
    _, states = record(hydro, 240.0)
    reach = float(hydro.bodies["radius"][0])
    assert states[:, 0, 2].min() > -reach, "it flew out of the water"
    rest = states[-1, 0]
    assert -reach < rest[2] < reach
    assert np.abs(rest[NU:]).max() < 0.02
    assert tilt(rest) < 0.05
    # Archimedes: at rest the immersed part carries the weight.
    nu_dot, _ = hydro.rates_of_change(0.0)
    assert abs(nu_dot[0, 2]) < 0.02


def test_a_dropped_body_comes_to_rest_without_gaining_height() -> None:
    """Let fall from above the water: each extreme of the heave lies within the one before, until it rests."""
    sphere = floating(SHAPE_SPHERE, (0.3, 0.0, 0.0), 60.0, 4.0 / 3.0 * math.pi * 0.3**3, 0.0)
    box = floating(SHAPE_BOX, (0.4, 0.3, 0.2), 120.0, 8.0 * 0.4 * 0.3 * 0.2, 0.02)
    hydro = Hydrodynamics([sphere, box], 1.0 / 240.0)
    hydro.state[:, 2] = -0.8
    _, states = record(hydro, 60.0)
    for row in range(2):
        z = states[:, row, 2] - states[-1, row, 2]
        swings = np.abs(z[1:-1][np.diff(np.sign(np.diff(z))) != 0])
        swings = swings[swings > 1e-3]
        assert len(swings) > 1
        assert np.all(np.diff(swings) < 0.0)
        assert swings[0] < abs(z[0])
        assert np.abs(states[-1, row, NU:]).max() < 1e-6


def test_bobbing_without_damping_does_not_grow() -> None:
    """The added mass scales with the submerged part, held within a step: that must not pump energy into the heave."""
    sphere = floating(SHAPE_SPHERE, (0.3, 0.0, 0.0), 58.0, 4.0 / 3.0 * math.pi * 0.3**3, 0.0)
    hydro = Hydrodynamics([replace(sphere, D_L=np.zeros((6, 6)))], 1.0 / 240.0)
    hydro.state[0, 2] = 0.15
    _, states = record(hydro, 120.0)
    z = states[:, 0, 2]
    first, last = np.ptp(z[:960]), np.ptp(z[-960:])
    assert last == pytest.approx(first, rel=0.01)
