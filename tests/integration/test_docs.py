"""Generated pages are up to date."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120


def test_reference_pages_are_up_to_date():
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools/reference_docs.py"), "--check"],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr


def test_vehicle_pages_are_up_to_date():
    """Runs all manoeuvres of all shipped vehicles again."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools/vehicle_pages.py"), "--check"],
        capture_output=True,
        text=True,
        timeout=10 * PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
