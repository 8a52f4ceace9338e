"""A finished cache is read and never written, whatever it lacks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

MODULE = """
from numba import njit


def double(x):
    return 2 * x
"""
FILL = "import kernel, numba; f = numba.njit(cache=True)(kernel.double); f(1)"
READ = """
import kernel, numba
from uwserver.physics.kernel.finished_cache import FinishedCache
f = numba.njit(kernel.double)
f._cache = FinishedCache(kernel.double)
assert f(21) == 42 and f(1.5) == 3.0
print(sum(f.stats.cache_hits.values()), sum(f.stats.cache_misses.values()))
"""


@pytest.fixture
def run(tmp_path: Path):  # type: ignore[no-untyped-def]
    (tmp_path / "kernel.py").write_text(MODULE)

    def go(code: str) -> str:
        path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
        environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return go


def test_what_is_there_is_loaded_and_what_is_not_is_compiled_and_not_kept(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    run(FILL)
    files = sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "cache").rglob("*"))
    assert files
    assert run(READ) == "1 1"
    assert sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "cache").rglob("*")) == files


def test_an_empty_one_is_no_error(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    assert run(READ) == "0 2"
    assert not list((tmp_path / "cache").rglob("*.nb?"))
