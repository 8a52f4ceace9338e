"""The cone of what a camera sees: what a ray may meet is never left out, and what lies behind is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.optical.camera.rays import Balls, Cone, balls_of, cone_of

RNG = np.random.Generator(np.random.PCG64(3))


def test_balls_hold_their_triangles_and_little_else() -> None:
    corners = RNG.normal(size=(3000, 1, 3)) * (8.0, 3.0, 0.5) + RNG.normal(size=(3000, 3, 3)) * 0.02
    balls = balls_of(corners)
    assert 20 < len(balls.radius) <= 216
    apart = np.linalg.norm(corners[:, None] - balls.centre[None, :, None], axis=3)
    assert (apart <= balls.radius[None, :, None] + 1e-9).all(axis=2).any(axis=1).all()
    assert balls.radius.max() < 0.6 * float(np.linalg.norm(corners.reshape(-1, 3), axis=1).max())
    one = balls_of(corners[:1])
    assert one.radius.shape == (1,)


def test_a_ball_that_a_ray_meets_is_never_left_out() -> None:
    cone = Cone(np.array((0.6, 0.0, 0.8)), 0.5, 0.03)
    met = 0
    for _ in range(2000):
        centre, radius = RNG.normal(size=3), float(RNG.uniform(0.001, 0.3))
        across = centre - (centre @ cone.axis) * cone.axis
        across /= np.linalg.norm(across)
        turned = RNG.uniform(0.0, cone.half, 40)
        rays = np.cos(turned)[:, None] * cone.axis + np.sin(turned)[:, None] * across
        towards = centre - 0.03 * across
        along = np.maximum(rays @ towards, 0.0)
        hit = (np.linalg.norm(towards - along[:, None] * rays, axis=1) <= radius).any()
        assert not hit or cone.meets(Balls(centre[None], np.array((radius,))))
        met += int(hit)
    assert met > 100


@pytest.mark.parametrize(
    ("x", "y", "expected"), [(-1.0, 0.0, False), (1.0, 0.9, False), (1.0, 0.5, True), (-0.05, 0.0, True)]
)
def test_what_lies_behind_or_beside_is_not_met(x: float, y: float, expected: bool) -> None:
    cone = cone_of(np.array(((1.0, 0.0, 0.0), (math.cos(0.5), 0.0, math.sin(0.5)))), np.zeros((1, 3)))
    assert cone.half == pytest.approx(0.5, abs=2e-3)
    assert cone.meets(Balls(np.array(((9.0, 90.0, 0.0), (x, y, 0.0))), np.array((1.0, 0.1)))) == expected
