"""The tree of boxes against every triangle in turn."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.rays.tree import DEEPEST, TreePicker, grow, nearest_of


def unit(rng: np.random.Generator, n: int) -> FloatArray:
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


def brute_force(corners: FloatArray, origin: FloatArray, direction: FloatArray, limit: float) -> IntArray:
    """The nearest triangle of each ray by Cramer's rule, all at once."""
    picked = np.full(len(origin), -1)
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    for k, (o, d) in enumerate(zip(origin, direction, strict=True)):
        volume = np.einsum("ij,ij->i", np.cross(u, v), np.broadcast_to(-d, u.shape))
        s = o - a
        x = np.einsum("ij,ij->i", np.cross(s, v), np.broadcast_to(-d, u.shape)) / volume
        y = np.einsum("ij,ij->i", np.cross(u, s), np.broadcast_to(-d, u.shape)) / volume
        t = np.einsum("ij,ij->i", np.cross(u, v), s) / volume
        hit = (x >= 0) & (y >= 0) & (x + y <= 1) & (t >= 0) & (t < limit)
        if hit.any():
            picked[k] = int(np.where(hit, t, np.inf).argmin())
    return picked


@pytest.mark.parametrize("count", [1, 2, 4, 5, 63, 1000])
def test_it_picks_the_triangle_that_brute_force_picks(count: int) -> None:
    rng = np.random.default_rng(count)
    corners = rng.uniform(-5, 5, (count, 1, 3)) + rng.uniform(-1, 1, (count, 3, 3))
    origin, direction = rng.uniform(-6, 6, (200, 3)), unit(rng, 200)
    # Towards some triangle, so that small trees are hit too.
    aim = corners[rng.integers(0, count, 200)].mean(axis=1) + rng.normal(scale=0.05, size=(200, 3)) - origin
    direction[::2] = (aim / np.linalg.norm(aim, axis=1)[:, None])[::2]
    tree = TreePicker(corners)
    for limit in (4.0, np.inf):
        want = brute_force(corners, origin, direction, limit)
        np.testing.assert_array_equal(tree.pick(origin, direction, np.full(200, limit)), want)
        assert (want >= 0).any()
    np.testing.assert_array_equal(tree.pick(origin, direction), want)


def test_no_ray_slips_through_a_closed_surface() -> None:
    """From inside a ball of triangles every ray hits, also those exactly at edges and corners."""
    n = 24
    a, b = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij")
    points = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], -1)
    points[:, -1], points[0], points[-1] = points[:, 0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]  # without a crack
    p, q, r, s = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    corners = np.concatenate([np.stack([p, q, r], -2).reshape(-1, 3, 3), np.stack([p, r, s], -2).reshape(-1, 3, 3)])
    tree = TreePicker(corners)
    ends = np.concatenate([corners.reshape(-1, 3), 0.5 * (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3)])
    direction = ends / np.linalg.norm(ends, axis=1)[:, None]
    assert (tree.pick(np.zeros_like(direction), direction) >= 0).all()


def test_along_the_axes_and_in_a_plane() -> None:
    """Directions with zeros, on a level square whose box has no height."""
    corners = np.array([[[-1, -1, 2], [1, -1, 2], [1, 1, 2]], [[-1, -1, 2], [1, 1, 2], [-1, 1, 2]]], float)
    tree = TreePicker(corners)
    origin = np.array(
        [[0.5, 0.2, 0.0], [0.2, 0.5, 0.0], [0.5, 0.2, 4.0], [0.5, 0.2, 0.0], [5.0, 0.2, 0.0], [-3.0, 0.2, 2.0]]
    )
    direction = np.array([[0, 0, 1], [0, 0, 1], [0, 0, -1], [0, 0, -1], [0, 0, 1], [1, 0, 0]], float)
    assert tree.pick(origin, direction).tolist() == [0, 1, 0, -1, -1, -1]


def test_of_a_triangle_that_is_sided_only_the_outside_is_met() -> None:
    """Three level squares below each other, of sided triangles or not, from above and from below."""
    square = np.array(
        [[[-1, -1, 2], [1, 1, 2], [1, -1, 2]], [[-1, -1, 2], [-1, 1, 2], [1, 1, 2]]], float
    )  # seen from z = 0
    corners = np.concatenate([square + np.array([0.0, 0.0, lower]) for lower in (0.0, 2.0, 4.0)])
    down, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
    above, below = np.array([0.5, 0.2, 0.0]), np.array([0.5, 0.2, 9.0])
    work = np.empty(DEEPEST, np.int64), np.empty(DEEPEST)
    for sided, seen, behind in (
        ([0] * 6, {0, 1}, {4, 5}),
        ([1] * 6, {0, 1}, {-1}),
        ([1, 1, 0, 0, 1, 1], {0, 1}, {2, 3}),
    ):
        tree = grow(corners, np.array(sided))
        assert nearest_of(tree, above, down, np.inf, *work) in seen
        assert nearest_of(tree, below, up, np.inf, *work) in behind


def test_the_answer_is_in_the_numbers_that_embree_gives() -> None:
    picked = TreePicker(np.eye(3)[None]).pick(np.zeros((1, 3), np.float32), np.full((1, 3), 0.577, np.float32))
    assert picked.dtype == np.int32
    assert picked.tolist() == [0]
