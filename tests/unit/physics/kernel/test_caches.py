"""Kernels are found by what they are made of: in another place, by another process; a file that does not fit is as none."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
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


def call(tree: Path) -> list[str]:
    """Call a kernel of a tree in a process of its own: result, hits, misses, whether numba's settings are as they were."""
    settings = {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(tree / "cache")}
    left_out = ("NUMBA_CACHE_DIR", "PYTHONDONTWRITEBYTECODE")
    environment = {k: v for k, v in os.environ.items() if k not in left_out} | settings
    done = subprocess.run(
        [sys.executable, "-c", CALL], env=environment, capture_output=True, text=True, timeout=300, cwd=tree
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def compiled_tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources, with a cache in which the kernel is."""
    tree = tmp_path_factory.mktemp("sources") / "one"
    shutil.copytree(Path(uwserver.__file__).parent, tree / "uwserver", ignore=shutil.ignore_patterns("__pycache__"))
    assert call(tree) == ["6.0", "0", "1", "True"]
    return tree


@pytest.fixture
def tree(compiled_tree: Path, tmp_path: Path) -> Path:
    """Both, somewhere else."""
    return shutil.copytree(compiled_tree, tmp_path / "two")


def kernel_of(tree: Path) -> Path:
    (found,) = (tree / "cache/uwserver").glob("kernels-*/linear.dot-*.kernel")
    return found


def put_into_package(tree: Path, level: str) -> Path:
    """Puts the kernel into the tree's package for a level, as wheels have it."""
    path = kernel_of(tree)
    body = store.read(path.parent, path.name)
    assert body is not None
    finished = tree / "uwserver/physics/kernel/finished" / f"{path.parent.name.split('-')[1]}-{level}"
    finished.mkdir(parents=True)
    store.write(finished, path.name, body)
    return finished / path.name


def test_another_place_with_the_same_sources_compiles_nothing(tree: Path) -> None:
    assert kernel_of(tree).parent.stat().st_mode & 0o777 == 0o700
    os.utime(tree / "uwserver/physics/kernel/linear.py", (1e9, 1e9))
    assert call(tree) == ["6.0", "1", "0", "True"]


def test_a_folder_that_others_can_write_is_neither_read_nor_written(tree: Path) -> None:
    kept = kernel_of(tree)
    kept.parent.chmod(0o777)
    before = kept.stat().st_mtime_ns
    assert call(tree) == ["6.0", "0", "1", "True"]
    assert kept.stat().st_mtime_ns == before


of_x86_64 = pytest.mark.skipif(platform.machine() != "x86_64", reason="levels of x86-64")


@of_x86_64
def test_kernels_of_the_package_serve(tree: Path) -> None:
    put_into_package(tree, "x86-64")
    shutil.rmtree(tree / "cache")
    assert call(tree)[1] == "1"


@of_x86_64
def test_files_that_do_not_fit_are_compiled_anew(tree: Path) -> None:
    """One of the package that is damaged, and then a whole one of the user that holds something else."""
    path, kept = put_into_package(tree, "x86-64"), kernel_of(tree)
    code = bytearray(path.read_bytes())
    begin = code.index(b"\x7fELF") + 64  # behind the header of the machine code
    code[begin : begin + 256] = bytes(256)
    path.write_bytes(code)
    store.write(kept.parent, kept.name, b"sound, but no pickle")
    assert call(tree) == ["6.0", "0", "1", "True"]
    assert len(store.read(kept.parent, kept.name) or b"") > 1000, "what was compiled is kept in its place"


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
