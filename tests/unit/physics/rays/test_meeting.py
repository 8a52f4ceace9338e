"""Rays of sensors in compiled code against those in Python: the same things are met at the same place, whatever finds the triangle."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, HalfSpace, Placed, Solid, Sphere, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.rays import surfaces
from uwserver.physics.rays.casting import Rays
from uwserver.physics.rays.meeting import meet
from uwserver.physics.rays.raycast import Hits, no_hits
from uwserver.physics.rays.rows import facets

NOBODYS: IntArray = np.zeros(0, np.int64)
STATE = np.array([[2.0, -1.0, 3.0, *quat_from_rpy(0.3, -0.2, 1.0), *[0.0] * 6], [0.0, 0.0, 1.0, 1.0, *[0.0] * 9]])


def ball(radius: float = 0.5) -> TriangleMesh:
    """Of more triangles than are intersected one by one."""
    corners = facets(Solid("ball", (Placed(Sphere(radius)),))).corners
    assert len(corners) > surfaces.FEW
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def bumps(n: int = 40) -> TriangleMesh:
    x = np.arange(n) - (n - 1) / 2
    X, Y = np.meshgrid(x, x, indexing="ij")
    vertices = np.stack([X, Y, 10 + 2 * np.sin(X / 4) + 2 * np.cos(Y / 5)], -1).reshape(-1, 3)
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:])
    return TriangleMesh(vertices, np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, d, b), (b, d, c))]))


def met(rays: Rays, origin: FloatArray, direction: FloatArray, limit: float, past: IntArray = NOBODYS) -> Hits:
    hits = no_hits(len(origin))
    meet(rays.ray_targets().table, origin, direction, limit, STATE, past, *hits)
    return hits


def everything() -> Rays:
    rays = Rays()
    rays.add_static(0, Solid("bumps", (Placed(bumps()),)))
    rays.add_static(1, Solid("bottom", (Placed(HalfSpace(), p=np.array([0.0, 0.0, 13.0])),)))
    rays.add_static(2, Solid("far away", (Placed(Sphere(3.0), p=np.array([3000.0, 0.0, 5.0])),)))
    rays.add_moving(3, Solid("ball", (Placed(ball(1.5)),)), 0)
    rays.add_moving(4, Solid("box", (Placed(Box((1.0, 0.5, 0.5))),)), 1)
    return rays


def some(n: int, seed: int = 4) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    direction = rng.normal((0.0, 0.0, 0.5), size=(n, 3))
    return rng.uniform((-25, -25, -6), (25, 25, 14), (n, 3)), direction / np.linalg.norm(direction, axis=1)[:, None]


def test_the_same_is_met_as_in_python_to_the_last_bit() -> None:
    rays, (origin, direction) = everything(), some(4000)
    origin[::4] = STATE[0, :3] + 0.1  # within the ball: its hidden sides let them out
    origin[1::8] += [3000.0, 0.0, 0.0]
    for limit in (5.0, 60.0):
        expected = rays.cast(STATE, origin, direction, limit)
        hits = met(rays, origin, direction, limit)
        for column, other in zip(hits, expected, strict=True):
            np.testing.assert_array_equal(column, other)
    assert set(np.unique(hits.body)) == {-1, 0, 1, 2, 3, 4}


@pytest.mark.parametrize("row", [0, 1])
def test_a_ray_passes_what_the_body_in_its_row_carries(row: int) -> None:
    rays, (origin, direction) = everything(), some(1000)
    past = np.where(np.arange(1000) % 2 == 0, row, -1)
    direction[:] = (STATE[row, :3] - origin) / np.linalg.norm(STATE[row, :3] - origin, axis=1)[:, None]
    hits, carried = met(rays, origin, direction, 100.0, past), 3 + row
    expected = rays.cast(STATE, origin, direction, 100.0)
    without = rays.cast(STATE, origin, direction, 100.0, row)
    for column, whole, rest in zip(hits, expected, without, strict=True):
        np.testing.assert_array_equal(column[1::2], whole[1::2])
        np.testing.assert_array_equal(column[::2], rest[::2])
    assert carried in hits.body[1::2]
    assert carried not in hits.body[::2]


def test_what_comes_and_goes_is_met_and_not_met() -> None:
    rays, down = Rays(), np.array([[0.0, 0.0, 1.0]])
    over = np.array([[2.0, -1.0, 0.0]])
    assert met(rays, over, down, 50.0).body.tolist() == [-1]
    rays.add_moving(3, Solid("ball", (Placed(ball()),)), 0)
    first = rays.ray_targets()
    assert rays.ray_targets() is first
    assert met(rays, over, down, 50.0).body.tolist() == [3]
    rays.remove(3)
    assert met(rays, over, down, 50.0).body.tolist() == [-1]
    rays.add_static(0, Solid("bumps", (Placed(bumps()),)))
    assert met(rays, over, down, 50.0).body.tolist() == [0]
    assert met(rays, over, down, 5.0).body.tolist() == [-1]


def test_without_rays_and_with_bad_ones_nothing_is_met() -> None:
    rays = everything()
    for n in (0, 1):
        assert met(rays, np.full((n, 3), np.nan), np.full((n, 3), np.nan), 10.0).body.tolist() == [-1] * n
