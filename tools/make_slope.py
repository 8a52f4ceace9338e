"""Writes the bathymetry of the scenarios `slope` and `remus_survey`: 400 m x 400 m, a point each 5 m, float32.

A shelf at 25 m depth in the south, a slope of 30 % (16.7 degrees) through N's origin, a basin at 55 m in the north; 50 m east and west of
the middle the slope is rough. Between -45 m and 45 m to the north and east it is a plane, so that tests know it in closed form.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

FILE = Path(__file__).parents[1] / "scenarios" / "uwserver_scenarios" / "assets" / "slope.npy"
SPACING_M = 5.0
POINTS = 81


def depths() -> np.ndarray:
    """Depth (POINTS, POINTS), m: rows to the north, columns to the east."""
    axis = (np.arange(POINTS) - POINTS // 2) * SPACING_M
    north, east = np.meshgrid(axis, axis, indexing="ij")
    shelf = 40.0 + np.clip(0.3 * north, -15.0, 15.0)
    rough = np.clip((np.abs(east) - 45.0) / 40.0, 0.0, 1.0)
    hills = 1.6 * np.sin(east / 17.0) * np.cos(north / 23.0) + 0.7 * np.sin(north / 9.0 + east / 13.0)
    return (shelf + rough * hills).astype(np.float32)


if __name__ == "__main__":
    FILE.parent.mkdir(exist_ok=True)
    np.save(FILE, depths())
    print(f"{FILE.name}: {FILE.stat().st_size} bytes")
