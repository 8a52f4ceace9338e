"""What only Python calls is kept without the code for callers; a finished cache is read and never written, whatever it lacks."""

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
from uwserver.physics.kernel.caches import FinishedCache
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


ENTRY = """
import numba
from uwserver.physics.kernel.compiled import compiled, entry


@compiled
def double(x):
    total = 0.0
    for k in range(200):
        total += x / (k + 1.0) ** 3 * (1.0 if k % 3 else -2.0)
    return total


@{decorator}
def top(x):
    return double(x) + double(x + 1.0)
"""
CALL = "import top; print(top.top(0.5), sum(top.top.stats.cache_hits.values()))"


def test_an_entry_is_loaded_by_another_process_from_its_machine_code_alone(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    sizes, values = {}, {}
    for decorator in ("compiled", "entry"):
        (tmp_path / "top.py").write_text(ENTRY.format(decorator=decorator))
        first, hits = run(CALL).split()
        again, hits_again = run(CALL).split()
        assert (hits, hits_again) == ("0", "1")
        assert again == first
        (kept,) = (tmp_path / "cache").rglob("top.top-*.nbc")
        sizes[decorator], values[decorator] = kept.stat().st_size, first
        kept.unlink()
    assert values["entry"] == values["compiled"]
    assert sizes["entry"] < 0.75 * sizes["compiled"]


def test_a_kernel_that_calls_an_entry_is_refused_when_it_is_compiled(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Loaded from the cache it would have nothing to call."""
    (tmp_path / "top.py").write_text(ENTRY.format(decorator="entry"))
    code = """
import numba, top
from uwserver.physics.kernel.compiled import compiled

@compiled
def above(x):
    return top.top(x)

try:
    above(1.0)
except numba.errors.TypingError as error:
    print("top is an entry: kernels call what is `compiled`" in str(error))
"""
    (tmp_path / "above.py").write_text(code)
    assert run("import above") == "True"
