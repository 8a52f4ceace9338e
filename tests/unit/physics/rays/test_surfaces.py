"""Embree picks the triangle that a ray meets first; hits are tested in test_casting."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("embreex")

from uwserver.physics.rays.surfaces import EmbreePicker
from uwserver.physics.rays.tree import TreePicker


def test_it_picks_what_the_tree_picks() -> None:
    rng = np.random.default_rng(4)
    corners = rng.uniform(-5, 5, (500, 1, 3)) + rng.uniform(-1, 1, (500, 3, 3))
    origin, direction = rng.uniform(-6, 6, (2, 2000, 3)).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    limit = rng.uniform(1.0, 20.0, 2000).astype(np.float32)
    ours, tree = (
        EmbreePicker(corners).pick(origin, direction, limit),
        TreePicker(corners).pick(origin, direction, limit),
    )
    assert (ours >= 0).sum() > 200
    assert (ours != tree).sum() <= 2  # rays past an edge, within float32
