"""How a hull is cut into strips."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, line_of
from uwserver.physics.dynamics.strip_params import MOST_STRIPS, TOLERANCE, strip_rows, strips_needed
from uwserver.physics.kernel.layout import SHAPE_BOX, SHAPE_SPHERE

ZERO = np.zeros((6, 6))


def body(*shapes: BuoyancyShape, length: float | None = None) -> BodyParams:
    return BodyParams(
        np.eye(6), ZERO, ZERO, ZERO, ZERO, 10.0, 10.0, (0.0,) * 3, (0.3, 0.1, -0.2), shapes=shapes, length=length
    )


def box(x: float, y: float, z: float) -> BuoyancyShape:
    return BuoyancyShape(SHAPE_BOX, (0.0, 0.0, 0.0), (x / 2, y / 2, z / 2), x * y * z)


def test_the_length_of_a_box_is_its_longest_edge() -> None:
    line = line_of(body(box(4.0, 0.4, 0.2)))
    assert (line.axis, line.half) == (0, pytest.approx(2.0))
    np.testing.assert_allclose(line.moment, [0.0, 1.0 - 0.05**2, 1.0 - 0.1**2])
    np.testing.assert_allclose(line.turn, np.array([0.0, 0.9975 / 1.0025, 0.99 / 1.01]) * 12.0 / 16.0)
    assert line_of(body(box(0.2, 0.3, 1.5)))[:2] == (2, pytest.approx(0.75))


def test_a_ball_and_a_cube_are_not_turned() -> None:
    """A wave strains the water; what is as long as wide and high has nothing for it to turn."""
    for shape in (BuoyancyShape(SHAPE_SPHERE, (0.0,) * 3, (0.3, 0.0, 0.0), 1.0), box(0.5, 0.5, 0.5)):
        line = line_of(body(shape))
        np.testing.assert_allclose([line.turn, line.moment], 0.0, atol=1e-12)


def test_two_floats_are_as_long_as_they_are_apart() -> None:
    """Two balls at +-d: second moment d^2 + R^2 / 5, that of a hull of sqrt(12 (d^2 + R^2 / 5))."""
    balls = [BuoyancyShape(SHAPE_SPHERE, (x, 0.0, 0.0), (0.1, 0.0, 0.0), 1.0) for x in (-1.0, 1.0)]
    assert 2.0 * line_of(body(*balls)).half == pytest.approx(math.sqrt(12.0 * (1.0 + 0.002)))


def test_a_given_length_counts_and_without_shapes_there_is_none() -> None:
    assert line_of(body(box(0.2, 0.3, 1.5), length=3.0))[:2] == (0, pytest.approx(1.5))
    assert line_of(body(length=2.0)).moment == (0.0, 1.0, 1.0)
    for point in (body(), body(box(4.0, 1.0, 1.0), length=0.0)):
        line = line_of(point)
        assert line.half == 0.0
        assert len(strip_rows(line, point.r_b, 100.0)) == 0
        assert not any(line.turn)


@pytest.mark.parametrize("phase", [0.006, 0.1, 0.5, 1.0, 1.4, 2.0, 3.0, 5.0, 9.0])
def test_there_are_strips_enough_for_force_and_moment(phase: float) -> None:
    """sin(p)/p and (sin p - p cos p)/p^2 for a wave that runs along the hull; one strip fewer would not do."""
    rows = strip_rows(line_of(body(box(4.0, 0.1, 0.1))), (0.0, 0.0, 0.0), phase / 2.0)
    x = rows["r"][:, 0] / 2.0
    np.testing.assert_allclose(rows["place"], x)
    force, moment = math.sin(phase) / phase, (math.sin(phase) - phase * math.cos(phase)) / phase**2
    assert np.sum(rows["share"] * np.cos(phase * x)) == pytest.approx(force, abs=TOLERANCE)
    assert np.sum(rows["share"] * x * np.sin(phase * x)) == pytest.approx(moment, abs=TOLERANCE)
    assert np.sum(rows["share"]) == pytest.approx(1.0)
    assert 2 <= len(rows) < MOST_STRIPS


def test_the_tide_needs_none_and_the_shortest_wave_not_more_than_there_are() -> None:
    assert [strips_needed(phase) for phase in (0.0, 1e-12, 0.004, 1e3)] == [0, 0, 0, MOST_STRIPS]


def test_the_weights_interpolate_polynomials() -> None:
    rows = strip_rows(line_of(body(length=2.0)), (0.0, 0.0, 0.0), 2.0)
    at = 0.77
    weights = rows["barycentric"] / (at - rows["place"])
    cubic = 1.0 + rows["place"] - 2.0 * rows["place"] ** 3
    assert len(rows) >= 4
    assert np.sum(weights * cubic) / np.sum(weights) == pytest.approx(1.0 + at - 2.0 * at**3)
    others = [[1.0 / (a - b) for b in rows["place"] if b != a] for a in rows["place"]]
    np.testing.assert_allclose(rows["bend"], np.sum(others, axis=1), atol=1e-9)
