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
from uwserver.physics.kernel import compiled, store
from uwserver.physics.kernel.compiled import LEVELS

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


def package(tree: Path, call: Call, tmp_path: Path) -> Callable[[str], Path]:
    """Compiles the kernel, and gives a function that puts it into the tree's package for a level, as wheels have it."""
    call(tree)
    path = kernel_of(tmp_path)
    body = store.read(path.parent, path.name)
    assert body is not None
    shutil.rmtree(tmp_path / "cache")

    def put(level: str) -> Path:
        finished = tree / "uwserver/physics/kernel/finished" / f"{path.parent.name.split('-')[1]}-{level}"
        finished.mkdir(parents=True)
        store.write(finished, path.name, body)
        return finished / path.name

    return put


of_x86_64 = pytest.mark.skipif(platform.machine() != "x86_64", reason="levels of x86-64")


@of_x86_64
@pytest.mark.parametrize(("level", "hits"), [("x86-64", "1"), ("x86-64-v9", "0")])
def test_kernels_of_the_package_serve_where_the_cpu_can_run_them(
    level: str, hits: str, tree: Path, call: Call, tmp_path: Path
) -> None:
    package(tree, call, tmp_path)(level)
    assert call(tree)[1] == hits


@of_x86_64
def test_kernels_of_a_package_that_are_damaged_are_compiled(tree: Path, call: Call, tmp_path: Path) -> None:
    path = package(tree, call, tmp_path)("x86-64")
    code = bytearray(path.read_bytes())
    begin = code.index(b"\x7fELF") + 64  # behind the header of the machine code
    code[begin : begin + 256] = bytes(256)
    path.write_bytes(code)
    assert call(tree) == ["6.0", "0", "1", "True"]


@of_x86_64
def test_kernels_that_another_numba_made_are_not_looked_at(tree: Path, call: Call, tmp_path: Path) -> None:
    """As after an upgrade of numba beside a wheel that pins another: its version is in the folder's name."""
    path = package(tree, call, tmp_path)("x86-64")
    sources, _, level = path.parent.name.partition("-")
    path.parent.rename(path.parent.with_name(f"{sources[::-1]}-{level}"))
    assert call(tree) == ["6.0", "0", "1", "True"]


@of_x86_64
@pytest.mark.parametrize(
    ("features", "levels"),
    [
        (",".join(f"+{feature}" for feature in (*LEVELS["x86-64-v3"], "avx512f")), ["x86-64-v3", "x86-64"]),
        (",".join(f"+{feature}" for feature in LEVELS["x86-64-v3"] if feature != "avx2") + ",-avx2", ["x86-64"]),
        ("", ["x86-64"]),
    ],
)
def test_the_best_level_comes_first_whose_every_feature_the_cpu_has(
    features: str, levels: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for level in LEVELS:
        (tmp_path / f"0123-{level}").mkdir()
    monkeypatch.setattr(compiled, "FINISHED", tmp_path)
    monkeypatch.setattr(compiled, "get_host_cpu_features", lambda: features)
    monkeypatch.setattr(compiled.numba.config, "CPU_FEATURES", None)
    assert [folder.name for folder in compiled._packaged("0123")] == [f"0123-{level}" for level in levels]
    assert compiled._packaged("4567") == ()


@of_x86_64
def test_who_chooses_a_cpu_by_hand_gets_kernels_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "0123-x86-64").mkdir()
    monkeypatch.setattr(compiled, "FINISHED", tmp_path)
    monkeypatch.setattr(compiled.numba.config, "CPU_NAME", "znver3")
    assert compiled._packaged("0123") == ()
