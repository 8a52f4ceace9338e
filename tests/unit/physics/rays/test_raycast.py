"""The answer of a world without anything solid."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics.rays.raycast import NOTHING, OpenWater, no_hits


@pytest.mark.parametrize("n", [0, 1, 5])
def test_open_water_has_nothing_to_hit(n: int) -> None:
    found = OpenWater().raycast(np.zeros((n, 3)), np.ones((n, 3)), 10.0)
    assert found.distance.tolist() == [np.inf] * n
    assert found.body.tolist() == found.material.tolist() == [NOTHING] * n
    assert found.normal.shape == (n, 3)


def test_an_answer_is_the_caller_s_to_fill_in() -> None:
    first, second = no_hits(2), no_hits(2)
    first.body[0], first.distance[1] = 7, 1.0
    assert first.material.tolist() == second.body.tolist() == [NOTHING] * 2
    assert second.distance.tolist() == [np.inf] * 2
