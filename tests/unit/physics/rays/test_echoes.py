"""What comes back of an incident intensity."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.rays.echoes import Ground, returned
from uwserver.physics.rays.raycast import NOTHING, Hits

GROUND = Ground(np.array([0.1, 0.02]), 0.5)


def hits_of(distance: Any, normal: Any, body: Any = None, material: Any = None) -> Hits:
    distance = np.atleast_1d(np.array(distance, float))
    n = len(distance)
    normals = np.broadcast_to(np.array(normal, float), (n, 3)).copy()
    body = np.zeros(n, np.int64) if body is None else np.array(body)
    return Hits(distance, normals, body, np.zeros(n, np.int64) if material is None else np.array(material))


def backscatter(direction: Any, hits: Hits) -> list[float]:
    rays = zip(direction, hits.normal, hits.body, hits.material, strict=True)
    return [returned(*ray, GROUND) for ray in rays]


def test_backscatter_is_lambert_s_law() -> None:
    angles = np.array([0.1, 0.8, math.pi / 2])
    direction = np.stack([np.cos(angles), np.zeros(3), np.sin(angles)], axis=1)
    out = backscatter(direction, hits_of([5.0] * 3, (0.0, 0.0, -1.0), material=[0, 1, 0]))
    np.testing.assert_allclose(out, [0.1, 0.02, 0.1] * np.sin(angles) ** 2)


def test_no_bottom_is_so_flat_that_nothing_comes_back_and_a_miss_is() -> None:
    direction = np.array([[1.0, 0.0, 0.0]] * 2)
    assert backscatter(direction, hits_of([5.0] * 2, (0.0, 0.0, -1.0), body=[0, NOTHING])) == pytest.approx(
        [0.1 * 1e-4, 0.0]
    )
