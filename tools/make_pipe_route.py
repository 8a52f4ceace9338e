"""Writes the seabed of the scenario `follow_the_pipe`: 80 m x 40 m, a point each metre, float32.

About 10 m deep, with sand waves and knolls. The pipe of the scenario lies on it but for one place, where the current has washed a trough under it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

FILE = Path(__file__).parents[1] / "scenarios" / "uwserver_scenarios" / "assets" / "pipe_route.npy"
POINTS = (81, 41)
"""To the north and to the east, a metre apart, with N's origin in the middle."""
PATH_NE = ((-28.0, -6.0), (-20.0, -6.0), (-12.0, -4.0), (-4.0, 0.0), (4.0, 5.0), (12.0, 8.0), (20.0, 8.5), (28.0, 7.0))
"""Of the pipe, m north and east."""
KNOLLS_NE = ((-16.0, -11.0, 1.4), (9.0, 0.0, 1.7), (18.0, 14.0, 1.5), (0.4, 2.8, 0.36))
"""North, east and height, m; the last carries the pipe, so that it spans nothing there."""
TROUGH_NE, TROUGH_M, DEEP_M = (8.0, 6.5), 2.2, 0.9
"""Where the sand is washed away, how wide and how deep."""


def depth(north: np.ndarray, east: np.ndarray) -> np.ndarray:
    """Of the sand without the trough, m."""
    waves = 0.45 * np.sin(north / 6.5) + 0.2 * np.sin((north + 2.0 * east) / 3.7)
    slope = 0.02 * north + 0.01 * east
    knolls = sum(h * np.exp(-((north - n) ** 2 + (east - e) ** 2) / 12.0) for n, e, h in KNOLLS_NE)
    return 10.0 + waves + slope - knolls


def depths() -> np.ndarray:
    """With the trough; rows to the north, columns to the east."""
    axes = ((np.arange(n) - n // 2).astype(float) for n in POINTS)
    north, east = np.meshgrid(*axes, indexing="ij")
    away = (north - TROUGH_NE[0]) ** 2 + (east - TROUGH_NE[1]) ** 2
    return (depth(north, east) + DEEP_M * np.exp(-away / TROUGH_M**2)).astype(np.float32)


if __name__ == "__main__":
    np.save(FILE, depths())
    print(f"{FILE.name}: {FILE.stat().st_size} bytes")
