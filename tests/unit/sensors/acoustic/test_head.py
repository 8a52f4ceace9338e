"""The head that steps: its angles follow from settings and memory alone, whatever these are set to meanwhile."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from uwserver.sensors.acoustic.head import head_arguments, step_on, turned


def steps(count: int, **sector: float) -> list[float]:
    head = SimpleNamespace(index=0, sense=1)
    asked = SimpleNamespace(**{"step": 0.1, "sector_center": 0.0, "sector_width": 0.4, **sector})
    return [step_on(asked, head) for _ in range(count)]


def test_to_and_fro_on_and_on_or_not_at_all() -> None:
    assert steps(7) == pytest.approx([-0.2, -0.1, 0.0, 0.1, 0.2, 0.1, 0.0])
    assert steps(3, sector_width=0.0, sector_center=0.3) == pytest.approx([0.3] * 3)
    around = steps(63, sector_width=2.0 * math.pi)
    assert around[62] == pytest.approx(around[0] + 62 * 2.0 * math.pi / 63 - 2.0 * math.pi, abs=0.05)


def test_a_narrower_sector_takes_the_head_in() -> None:
    head = SimpleNamespace(index=500, sense=1)
    asked = SimpleNamespace(step=0.1, sector_center=0.0, sector_width=0.4)
    assert step_on(asked, head) == pytest.approx(0.2)
    assert (head.index, head.sense) == (3, -1)


def test_axes_turn_from_x_to_y() -> None:
    assert turned(0.5 * math.pi) @ (1.0, 0.0, 0.0) == pytest.approx((0.0, 1.0, 0.0))
    assert np.allclose(turned(0.3) @ turned(-0.3), np.eye(3))
    assert head_arguments(0.1)[2].minimum == 0.1
