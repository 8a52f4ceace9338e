"""Lenses: distortion and back, what folds is refused, and angles of a fisheye."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.optical.camera.lens import Lens, lens_of


def test_the_axis_and_the_field_of_view() -> None:
    lens = lens_of((640, 480), 1.4)
    rays = lens.directions(np.array((319.5, 0.0, 639.0)), np.array((239.5, 239.5, 239.5)))
    np.testing.assert_allclose(rays[0], (1.0, 0.0, 0.0), atol=1e-12)
    # The right of the picture is to starboard.
    np.testing.assert_allclose(rays[1:, 1], (-math.sin(0.7), math.sin(0.7)), rtol=1e-12)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("pinhole", ()),
        ("brown_conrady", (-0.28, 0.09, 0.001, -0.0007, -0.012)),
        ("fisheye", (-0.02, 0.004, -0.001, 0.0002)),
    ],
)
def test_distortion_and_back_within_a_thousandth_of_a_pixel(model: str, coefficients: tuple[float, ...]) -> None:
    lens = lens_of((640, 480), 1.4, model, coefficients)  # type: ignore[arg-type]
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 639, 65), np.linspace(0, 479, 49)))
    back = lens.pixels(lens.directions(u, v))
    assert np.hypot(back[0] - u, back[1] - v).max() < 1e-3


def test_a_strong_barrel_near_where_it_folds() -> None:
    """Corners at 0.8 focal lengths, of 0.86 where such a lens folds: three steps leave 17 px."""
    lens = lens_of((640, 480), 1.138, "brown_conrady", (-0.2,))
    u, v = np.array((0.0, 639.0)), np.array((0.0, 479.0))
    back = lens.pixels(lens.directions(u, v))
    assert np.hypot(back[0] - u, back[1] - v).max() < 1e-3


def test_brown_conrady_is_that_of_opencv() -> None:
    """By hand: x = 0.5, y = 0.25, r2 = 0.3125, radial 1 + k1 r2 + k2 r4 + k3 r6, tangential as OpenCV has it."""
    k1, k2, p1, p2, k3 = 0.1, -0.05, 0.01, 0.02, 0.005
    lens = Lens(100, 100, 200.0, 100.0, 10.0, 20.0, "brown_conrady", (k1, k2, p1, p2, k3))
    radial = 1.0 + k1 * 0.3125 + k2 * 0.3125**2 + k3 * 0.3125**3
    x = 0.5 * radial + 2 * p1 * 0.125 + p2 * (0.3125 + 0.5)
    y = 0.25 * radial + p1 * (0.3125 + 0.125) + 2 * p2 * 0.125
    u, v = lens.pixels(np.array(((1.0, 0.5, 0.25),)))
    np.testing.assert_allclose((u[0], v[0]), (200.0 * x + 10.0, 100.0 * y + 20.0), rtol=1e-12)


def test_a_fisheye_looks_beyond_the_side() -> None:
    lens = lens_of((641, 361), 3.4, "fisheye")
    (ray,) = lens.directions(np.array((640.0,)), np.array((180.0,)))
    assert math.atan2(ray[1], ray[0]) == pytest.approx(1.7)


def test_what_folds_is_refused() -> None:
    with pytest.raises(ValueError, match="folds"):
        lens_of((640, 480), 2.4, "brown_conrady", (-0.4,)).check()
    with pytest.raises(ValueError, match="folds"):
        lens_of((640, 480), 3.4, "fisheye", (-1.0,))
    with pytest.raises(ValueError, match="0 coefficients"):
        lens_of((640, 480), 1.0, "pinhole", (0.1,))
