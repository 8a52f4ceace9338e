"""FakeGeometry against closed forms and a brute-force march."""

from __future__ import annotations

import numpy as np

from uwserver.physics.rays.raycast import OpenWater
from uwserver.testing.fake_geometry import FakeGeometry, Plane, Sphere

SEABED = Plane((0.0, 0.0, 20.0), (0.0, 0.0, -1.0))


def cast(geometry, origin, direction, max_range=100.0):
    d = np.atleast_2d(np.array(direction, float))
    d = d / np.linalg.norm(d, axis=1)[:, None]
    return geometry.raycast(np.atleast_2d(np.array(origin, float)), d, max_range)


def test_straight_and_slanted_down():
    hits = cast(FakeGeometry([SEABED]), [[0, 0, 5], [3, 1, 5]], [[0, 0, 1], [0, 1, 1]])
    assert np.allclose(hits.distance, [15.0, 15.0 * np.sqrt(2)])
    assert np.array_equal(hits.normal, [[0, 0, -1], [0, 0, -1]])
    assert hits.body.tolist() == [0, 0]


def test_away_from_it_behind_it_and_too_far():
    geometry = FakeGeometry([SEABED])
    hits = cast(geometry, [[0, 0, 5], [0, 0, 25], [0, 0, 5]], [[0, 0, -1], [0, 0, 1], [1, 0, 0]])
    assert np.all(np.isinf(hits.distance))
    assert hits.body.tolist() == [-1, -1, -1]
    assert np.isinf(cast(geometry, [0, 0, 5], [0, 0, 1], 14.9).distance[0])


def test_the_nearest_wins_with_its_normal():
    geometry = FakeGeometry([SEABED, Sphere((0.0, 0.0, 10.0), 2.0)])
    hits = cast(geometry, [[0, 0, 0], [5, 0, 0]], [[0, 0, 1], [0, 0, 1]])
    assert np.allclose(hits.distance, [8.0, 20.0])
    assert np.allclose(hits.normal[0], [0, 0, -1])
    assert hits.body.tolist() == [1, 0]


def test_random_rays_against_a_march():
    rng = np.random.default_rng(1)
    sphere = Sphere((1.0, 2.0, 8.0), 3.0)
    origin = rng.uniform(-10, 10, (200, 3)) * [1, 1, 0.2]
    direction = rng.normal(size=(200, 3))
    hits = cast(FakeGeometry([sphere]), origin, direction)
    unit = direction / np.linalg.norm(direction, axis=1)[:, None]
    steps = np.arange(0.0, 40.0, 0.01)
    for k in range(200):
        points = origin[k] + steps[:, None] * unit[k]
        inside = np.linalg.norm(points - sphere.center, axis=1) < sphere.radius
        if inside[0]:
            assert np.isinf(hits.distance[k])
        elif inside.any():
            assert abs(hits.distance[k] - steps[inside.argmax()]) < 0.011
        elif np.isfinite(hits.distance[k]):
            graze = origin[k] + hits.distance[k] * unit[k]
            assert abs(np.linalg.norm(graze - sphere.center) - sphere.radius) < 1e-9


def test_open_water_is_empty():
    assert cast(OpenWater(), [0, 0, 0], [0, 0, 1]).body.tolist() == [-1]
