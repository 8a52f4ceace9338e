"""The name of the kernel cache: it follows the files that decide what a kernel does, and no others."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import uwserver
from uwserver.physics.kernel.compiled import kernel_sources

PACKAGE = Path(uwserver.__file__).parent
NAME = "from uwserver.physics.kernel.compiled import cache_state; print(cache_state.folder.name)"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the source tree, to be edited."""
    shutil.copytree(PACKAGE, tmp_path / "tree/uwserver", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "tree"


def cache_of(tree: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / "cache")}
    command = [sys.executable, "-c", NAME]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True, cwd=tree)
    return done.stdout.strip()


@pytest.mark.parametrize("kernel", ["dynamics/foil.py", "contact/solver.py", "rays/hits.py", "kernel/layout.py"])
def test_an_edited_kernel_gets_a_new_cache(tree: Path, kernel: str) -> None:
    before = cache_of(tree)
    source = tree / "uwserver/physics" / kernel
    source.write_text(source.read_text() + "\nEDITED = 1\n")
    assert cache_of(tree) != before


def test_a_comment_elsewhere_keeps_the_cache(tree: Path) -> None:
    before = cache_of(tree)
    for source in ("scene.py", "bodies.py", "collision/bullet.py", "dynamics/params.py"):
        path = tree / "uwserver/physics" / source
        path.write_text(path.read_text() + "\n# A comment.\n")
    assert cache_of(tree) == before


def test_what_is_compiled_is_found_with_what_it_imports() -> None:
    physics = PACKAGE / "physics"
    found = {path.relative_to(physics).as_posix() for path in kernel_sources(physics)}
    decorated = {p.relative_to(physics).as_posix() for p in physics.rglob("*.py") if "\n@compiled" in p.read_text()}
    assert decorated <= found
    assert {"kernel/layout.py", "kernel/compiled.py", "rays/raycast.py"} <= found  # constants frozen into kernels
    assert "warm.py" not in found
