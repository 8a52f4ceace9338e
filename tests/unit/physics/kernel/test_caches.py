"""Kernels are found by what they are made of: in another place, by another process; a file that does not fit is as none."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import uwserver
from uwserver.physics.kernel import store

CALL = """
import numba, numpy
before = numba.config.CACHE_DIR
from uwserver.physics.kernel.linear import dot
print(dot(numpy.array([1.0, 2.0, 3.0]), numpy.ones(3)), *(sum(n.values()) for n in dot._entry.stats[1:]), numba.config.CACHE_DIR == before)
"""
Call = Callable[[Path], list[str]]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the sources."""
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(uwserver.__file__).parent, tmp_path / "one/uwserver", ignore=ignore)
    return tmp_path / "one"


@pytest.fixture
def call(tmp_path: Path) -> Call:
    """Call a kernel of a tree in a process of its own: result, hits, misses, whether numba's settings are as they were."""

    def go(tree: Path) -> list[str]:
        settings = {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(tmp_path / "cache")}
        environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | settings
        done = subprocess.run(
            [sys.executable, "-c", CALL], env=environment, capture_output=True, text=True, timeout=300, cwd=tree
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    return go


def kernel_of(tmp_path: Path) -> Path:
    (found,) = (tmp_path / "cache/uwserver").glob("kernels-*/linear.dot-*.kernel")
    return found


def test_another_place_with_the_same_sources_compiles_nothing(tree: Path, call: Call, tmp_path: Path) -> None:
    assert call(tree) == ["6.0", "0", "1", "True"]
    assert kernel_of(tmp_path).parent.stat().st_mode & 0o777 == 0o700
    other = tree.rename(tree.with_name("two"))
    os.utime(other / "uwserver/physics/kernel/linear.py", (1e9, 1e9))
    assert call(other) == ["6.0", "1", "0", "True"]


def test_files_that_do_not_fit_are_compiled_anew(tree: Path, call: Call, tmp_path: Path) -> None:
    call(tree)
    path = kernel_of(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert call(tree) == ["6.0", "0", "1", "True"]
    store.write(path.parent, path.name, b"sound, but no pickle")
    assert call(tree) == ["6.0", "0", "1", "True"]
    assert call(tree) == ["6.0", "1", "0", "True"]


def test_a_folder_that_others_can_write_is_neither_read_nor_written(tree: Path, call: Call, tmp_path: Path) -> None:
    call(tree)
    kept = kernel_of(tmp_path)
    kept.parent.chmod(0o777)
    before = kept.stat().st_mtime_ns
    assert call(tree) == ["6.0", "0", "1", "True"]
    assert kept.stat().st_mtime_ns == before


@pytest.mark.skipif(platform.machine() != "x86_64", reason="levels of x86-64")
@pytest.mark.parametrize(("level", "hits"), [("x86-64", "1"), ("x86-64-v9", "0")])
def test_kernels_of_the_package_serve_where_the_cpu_can_run_them(
    level: str, hits: str, tree: Path, call: Call, tmp_path: Path
) -> None:
    call(tree)
    path = kernel_of(tmp_path)
    body = store.read(path.parent, path.name)
    assert body is not None
    finished = tree / "uwserver/physics/kernel/finished" / f"{path.parent.name.split('-')[1]}-{level}"
    finished.mkdir(parents=True)
    store.write(finished, path.name, body)
    shutil.rmtree(tmp_path / "cache")
    assert call(tree)[1] == hits
