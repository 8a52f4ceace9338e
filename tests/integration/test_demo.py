"""`make demo`: a server, the example client, a square within its bounds, and the picture."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TRACK_M, DEPTH_M = 0.13, 0.02
"""What the controller of the example holds, about twice what it does."""


def test_make_runs_the_demo():
    recipe = subprocess.run(["make", "-n", "demo"], cwd=ROOT, capture_output=True, text=True, check=True, timeout=30)
    assert "tools/demo.py" in recipe.stdout


@pytest.mark.slow
def test_the_demo_drives_its_square_and_draws_it(tmp_path):
    picture = tmp_path / "square.png"
    command = [sys.executable, str(ROOT / "tools/demo.py"), "--out", str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    found = re.search(r"track error at most ([\d.]+) m, depth error at most ([\d.]+) m", done.stdout)
    assert found, done.stdout
    assert 0.0 < float(found[1]) < TRACK_M
    assert 0.0 < float(found[2]) < DEPTH_M
    assert picture.read_bytes().startswith(b"\x89PNG")
