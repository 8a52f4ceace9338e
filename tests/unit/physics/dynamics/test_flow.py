"""The water at a point: derivatives against differences, the laws of linear waves, and the rows that bodies get.

`tests/physics/test_moving_water.py` proves what such water does to bodies.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics import flow
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import (
    BODY,
    FLOW_GRADIENT,
    FLOW_KIND,
    FLOW_P,
    FLOW_PLANE,
    FLOW_SIZE,
    FLOW_T,
    FLOW_V,
    FLOW_V_T,
    MOVING,
    PROFILE_SIZE,
    WAVE_SIZE,
    WAVY,
    WORLD,
    SeaRows,
    addresses,
)

G = 9.81
PLACE = (3.0, -2.0, 4.0, 1.7)


def wave(
    amplitude: float = 0.4, period: float = 5.0, heading: float = 0.6, depth: float = math.inf, phase: float = 0.3
) -> Any:
    """A row of the dispersion relation omega^2 = g k tanh(k h)."""
    omega = 2.0 * math.pi / period
    k = omega**2 / G
    for _ in range(200):
        k = omega**2 / (G * math.tanh(min(k * depth, 50.0)))
    return [k * math.cos(heading), k * math.sin(heading), k, omega, amplitude, phase, depth]


def sea(waves: Any = (), profiles: Any = (), uniform: Any = (0.0,) * 7) -> SeaRows:
    return SeaRows(
        np.array(uniform, float), np.array(profiles, float).reshape(-1, PROFILE_SIZE), np.array(waves, float).reshape(-1, WAVE_SIZE)
    )  # fmt: skip


def at(water: SeaRows, x: float, y: float, z: float, t: float) -> FloatArray:
    point = np.full(flow.POINT_SIZE, np.nan)
    flow.water_at(water, x, y, z, t, point)
    assert np.isfinite(point).all()
    return point


PROFILE = [0.0, 10.0, 2.0, *(0.1, 0.02, -0.003, 0.0004), *(0.2, -0.01, 0.002, 0.0), *(0.0, 0.001, 0.0, 0.0)]
SEAS = {
    "deep": sea([wave()]),
    "shallow": sea([wave(depth=6.0, period=9.0)]),
    "two and a shear": sea([wave(), wave(0.1, 3.0, -1.0, 8.0)], [PROFILE], (0.3, -0.1, 0.0, 0.01, 0.02, 0.0, 1.0)),
}


@pytest.mark.parametrize("name", SEAS)
def test_rate_and_gradient_are_the_derivatives_of_the_velocity(name: str) -> None:
    h, here = 1e-5, at(SEAS[name], *PLACE)
    for axis in range(4):
        step = np.eye(4)[axis] * h
        slope = (at(SEAS[name], *(PLACE + step)) - at(SEAS[name], *(PLACE - step)))[flow.V : flow.V + 3] / (2.0 * h)
        expected = here[flow.V_T : flow.V_T + 3] if axis == 3 else here[flow.GRADIENT + axis : flow.GRADIENT + 9 : 3]
        np.testing.assert_allclose(slope, expected, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("name", SEAS)
def test_slopes_and_rate_are_the_derivatives_of_the_elevation(name: str) -> None:
    h, here = 1e-5, at(SEAS[name], *PLACE)
    for axis, column in ((0, flow.SLOPE), (1, flow.SLOPE + 1), (3, flow.ELEVATION_T)):
        step = np.eye(4)[axis] * h
        slope = (at(SEAS[name], *(PLACE + step)) - at(SEAS[name], *(PLACE - step)))[flow.ELEVATION] / (2.0 * h)
        assert slope == pytest.approx(here[column], abs=1e-8)


@pytest.mark.parametrize("name", ["deep", "shallow"])
def test_waves_keep_volume_and_have_no_rotation(name: str) -> None:
    gradient = at(SEAS[name], *PLACE)[flow.GRADIENT : flow.GRADIENT + 9].reshape(3, 3)
    assert np.trace(gradient) == pytest.approx(0.0, abs=1e-14)
    np.testing.assert_allclose(gradient, gradient.T, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("name", ["deep", "shallow"])
def test_the_surface_moves_with_the_water_and_the_bottom_stays(name: str) -> None:
    """Kinematic conditions of linear theory; z is down, so the elevation rises at -w."""
    top = at(SEAS[name], 3.0, -2.0, 0.0, 1.7)
    assert top[flow.ELEVATION_T] == pytest.approx(-top[flow.V + 2])
    assert top[flow.HEAD] == pytest.approx(top[flow.ELEVATION])
    depth = 6.0 if name == "shallow" else 500.0
    assert at(SEAS[name], 3.0, -2.0, depth, 1.7)[flow.V + 2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", ["deep", "shallow"])
def test_pressure_accelerates_the_water(name: str) -> None:
    """Linear Euler equation: dv/dt = -g grad(head)."""
    h, here = 1e-5, at(SEAS[name], *PLACE)
    for axis in range(3):
        step = np.eye(4)[axis] * h
        slope = (at(SEAS[name], *(PLACE + step)) - at(SEAS[name], *(PLACE - step)))[flow.HEAD] / (2.0 * h)
        assert -G * slope == pytest.approx(here[flow.V_T + axis], abs=1e-6)


@pytest.mark.parametrize("name", SEAS)
def test_above_the_still_level_the_velocity_is_that_of_the_level(name: str) -> None:
    np.testing.assert_array_equal(at(SEAS[name], 1.0, 2.0, -0.5, 0.3)[:3], at(SEAS[name], 1.0, 2.0, -2.0, 0.3)[:3])


def test_water_of_kilometres_depth_is_deep_water() -> None:
    """Hyperbolic functions of such depths overflow."""
    np.testing.assert_allclose(at(sea([wave(depth=5000.0)]), *PLACE), at(sea([wave()]), *PLACE), rtol=1e-12, atol=1e-14)


def test_profiles_hold_between_their_depths_and_add_up() -> None:
    two = sea(profiles=[PROFILE, PROFILE])
    s = 2.0
    assert at(two, 0.0, 0.0, 4.0, 0.0)[flow.V] == pytest.approx(2.0 * (0.1 + 0.02 * s - 0.003 * s**2 + 0.0004 * s**3))
    assert not at(two, 0.0, 0.0, 10.0, 0.0)[:3].any()
    assert at(two, 0.0, 0.0, 0.0, 0.0)[:3].any()


def test_the_uniform_part_drifts_from_its_instant() -> None:
    water = sea(uniform=(0.3, -0.1, 0.0, 0.01, 0.02, 0.0, 5.0))
    np.testing.assert_allclose(at(water, 9.0, 9.0, 9.0, 15.0)[:3], [0.4, 0.1, 0.0])


def rows(water: SeaRows, ahead: float) -> tuple[FloatArray, FloatArray]:
    """The row of one body, and the place for which it should be."""
    bodies, state, flows = np.zeros(1, BODY), np.zeros((1, 13)), np.full((1, FLOW_SIZE), np.nan)
    bodies["r_b"] = r = np.array([0.2, 0.1, -0.3])
    q = quat_from_rpy(0.2, -0.1, 0.9)
    nu = np.array([1.0, 0.2, -0.1, 0.3, -0.2, 0.1])
    state[0] = *PLACE[:3], *q, *nu
    arrays = {**vars(Hydrodynamics((), 0.01)), "bodies": bodies, "state": state, "flows": flows}
    flow.fill_flows(addresses(WORLD, arrays), water, PLACE[3], ahead)
    R = np.array(matrix(q))
    return flows[0], np.array(PLACE[:3]) + R @ r + ahead * R @ (nu[:3] + np.cross(nu[3:], r))


@pytest.mark.parametrize("ahead", [0.0, 0.05])
@pytest.mark.parametrize("name", SEAS)
def test_a_body_gets_the_water_at_its_centre_of_buoyancy_on_its_way(name: str, ahead: float) -> None:
    row, p = rows(SEAS[name], ahead)
    point = at(SEAS[name], *p, PLACE[3] + ahead)
    np.testing.assert_allclose(row[FLOW_P : FLOW_P + 3], p, rtol=0.0, atol=1e-14)
    assert row[FLOW_T] == PLACE[3] + ahead
    for ours, theirs, n in ((FLOW_V, flow.V, 3), (FLOW_V_T, flow.V_T, 3), (FLOW_GRADIENT, flow.GRADIENT, 9)):
        np.testing.assert_allclose(row[ours : ours + n], point[theirs : theirs + n], rtol=0.0, atol=1e-14)
    elevation = row[FLOW_PLANE] + row[FLOW_PLANE + 1] * p[0] + row[FLOW_PLANE + 2] * p[1]
    assert elevation == pytest.approx(point[flow.ELEVATION])
    assert row[FLOW_PLANE + 3] == point[flow.ELEVATION_T]


def test_the_kind_tells_what_counts() -> None:
    assert rows(SEAS["deep"], 0.0)[0][FLOW_KIND] == WAVY
    assert rows(sea(profiles=[PROFILE]), 0.0)[0][FLOW_KIND] == MOVING
