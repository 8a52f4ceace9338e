"""Fewer layers that are as good."""

from __future__ import annotations

import numpy as np
from ray_rig import thermocline

from uwserver.environment.acoustics.thinning import thin_out


def test_thinning_keeps_what_bends():
    grid = np.arange(0.0, 1000.0, 0.5)
    speed = thermocline(grid)[0]
    kept = thin_out(grid, speed, 1e-3)
    assert np.abs(np.interp(grid, grid[kept], speed[kept]) - speed).max() <= 1e-3
    assert 20 < len(kept) < 300
    assert list(thin_out(grid, 1500.0 + 0.016 * grid, 1e-3)) == [0, len(grid) - 1]
