"""The acoustic channel beside BELLHOP (M. B. Porter), the reference of ray models, where it is installed: ``pip install aubellhop`` brings it for
Python 3.12 and newer. Set UWSERVER_BELLHOP to its ``bellhop.exe``."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from ray_rig import duct, thermocline

from uwserver.environment.acoustics.boundaries import SEDIMENTS, Boundaries
from uwserver.environment.acoustics.channel import Channel

BELLHOP = os.environ.get("UWSERVER_BELLHOP") or shutil.which("bellhop.exe")
DEPTH, FREQUENCY, SAND = 150.0, 10e3, SEDIMENTS["sand"]
LEVEL, DELAY, LEAVES, COMES, TOP, BOTTOM = 0, 2, 4, 5, 6, 7
"""Columns of an arrival."""


def arrivals(folder: Path, z: np.ndarray, c: np.ndarray, x: float, a: float, b: float) -> np.ndarray:
    """(n, 8) of all geometric beams."""
    profile = [f"{depth} {speed} /" for depth, speed in zip(z, c, strict=True)]
    sand = f"{DEPTH} {c[-1] * SAND.speed_ratio} 0.0 {SAND.density_ratio} {SAND.attenuation_db} /"
    ends = ["1", f"{a} /", "1", f"{b} /", "1", f"{x / 1e3} /"]
    beams = ["'AG'", "40001", "-60 60 /", f"0.0 {DEPTH * 1.01} {x * 1.01 / 1e3}"]
    text = ["'channel'", f"{FREQUENCY}", "1", "'CVW'", f"0 0.0 {DEPTH}", *profile, "'A' 0.0", sand, *ends, *beams]
    (folder / "case.env").write_text("\n".join(text) + "\n", encoding="utf-8")
    assert BELLHOP is not None
    subprocess.run([BELLHOP, "case"], cwd=folder, check=True, timeout=120, capture_output=True)
    lines = (folder / "case.arr").read_text(encoding="utf-8").splitlines()[7:]
    return np.array([[float(word) for word in line.split()] for line in lines])


@pytest.mark.skipif(
    BELLHOP is None, reason="no BELLHOP: pip install aubellhop, and UWSERVER_BELLHOP=/path/of/bellhop.exe"
)
@pytest.mark.parametrize(("speed", "x", "a", "b"), [(thermocline, 900.0, 5.0, 60.0), (duct, 1500.0, 50.0, 75.0)])
def test_rays_times_angles_and_levels(tmp_path, speed, x, a, b):
    """Each of our rays is one of BELLHOP's. It integrates in steps and spreads a ray over beams, so it is the coarser one in time and angle; where
    rays turn its tubes are torn by the corners of the profile."""
    z = np.arange(0.0, DEPTH + 0.1, 1.0)
    c = speed(z)[0]
    theirs = arrivals(tmp_path, z, c, x, a, b)
    ours = Channel(z, c, FREQUENCY).paths(x, a, b, Boundaries(DEPTH, SAND))
    assert len(ours) >= 5
    for path in ours:
        same = theirs[(theirs[:, TOP] == path.surface) & (theirs[:, BOTTOM] == path.bottom)]
        dips = np.degrees([path.dip_a, path.dip_b])  # as in its files
        beside = np.hypot(same[:, LEAVES] - dips[0], same[:, COMES] - dips[1])
        near = same[beside.argmin()]
        assert near[DELAY] == pytest.approx(path.time, abs=30e-6)
        assert (near[LEAVES], near[COMES]) == (pytest.approx(dips[0], abs=0.02), pytest.approx(dips[1], abs=0.15))
        assert -20.0 * math.log10(near[LEVEL]) == pytest.approx(path.loss, abs=1.0 if path.turns else 0.05)
    loud = theirs[theirs[:, TOP] + theirs[:, BOTTOM] <= 2]
    assert np.abs(loud[:, DELAY, None] - [path.time for path in ours]).min(axis=1).max() < 50e-6
