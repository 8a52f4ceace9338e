"""Kernels are found by what they are made of: in another place, by another process; a file that does not fit is as none."""

from __future__ import annotations

import os
import pickle
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


def test_another_place_with_the_same_sources_compiles_nothing(tmp_path: Path) -> None:
    tree = tmp_path / "one"
    half_written = shutil.ignore_patterns("*.pyc.*")  # byte code, by another process
    shutil.copytree(Path(uwserver.__file__).parent, tree / "uwserver", ignore=half_written)
    assert call(tree) == ["6.0", "0", "1", "True"]
    (kept,) = (tree / "cache/uwserver").glob("kernels-*/linear.dot-*.kernel")
    assert kept.parent.stat().st_mode & 0o777 == 0o700
    other = tree.rename(tree.with_name("two"))
    os.utime(other / "uwserver/physics/kernel/linear.py", (1e9, 1e9))
    assert call(other) == ["6.0", "1", "0", "True"]


def double(x: float) -> float:
    return 2.0 * x


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A folder of the user's, in which a kernel is."""
    folder = tmp_path / "kernels-0123"
    folder.mkdir(mode=0o700)
    assert hits((), folder) == 0
    return folder


def hits(packaged: tuple[Path, ...], own: Path | None) -> int:
    """How often a kernel that is called once was found in these folders."""
    kernel = compiled.Entry(double)
    kernel._cache = compiled.files_of(double, packaged, own, kept=own is not None)
    assert kernel(3.0) == 6.0
    assert sum(kernel.stats.cache_hits.values()) + sum(kernel.stats.cache_misses.values()) == 1
    return sum(kernel.stats.cache_hits.values())


def the_file(folder: Path) -> Path:
    (found,) = folder.glob("test_caches.double+*.kernel")
    return found


def packaged(own: Path) -> Path:
    """The kernel in a folder as wheels have it."""
    folder = own.with_name("0123-x86-64")
    folder.mkdir()
    body = store.read(own, the_file(own).name)
    assert body is not None
    store.write(folder, the_file(own).name, body)
    return folder


def test_kernels_of_the_package_serve_without_a_folder_of_the_user(own: Path) -> None:
    folder = packaged(own)
    assert hits((folder,), None) == 1
    assert hits((own.with_name("nothing"), folder), None) == 1


def test_a_kernel_that_is_kept_serves(own: Path) -> None:
    assert hits((own.with_name("nothing"),), own) == 1


def test_a_file_of_the_package_that_is_damaged_is_as_none(own: Path) -> None:
    folder = packaged(own)
    code = bytearray(the_file(folder).read_bytes())
    begin = code.index(b"\x7fELF") + 64  # behind the header of the machine code
    code[begin : begin + 64] = bytes(64)
    the_file(folder).write_bytes(code)
    assert hits((folder,), None) == 0
    assert hits((folder,), own) == 1


@pytest.mark.parametrize("body", [b"", b"sound, but no pickle", pickle.dumps((1, 2, 3)), pickle.dumps(None)])
def test_a_file_that_does_not_fit_is_written_anew(own: Path, body: bytes) -> None:
    store.write(own, the_file(own).name, body)
    assert hits((), own) == 0
    assert hits((), own) == 1


def test_a_folder_that_others_can_write_is_neither_read_nor_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    found = compiled._find_cache()
    assert found.folder is not None
    assert found.folder.parent == tmp_path
    found.folder.chmod(0o777)
    found = compiled._find_cache()
    assert found.folder is None
    assert "chmod 700" in found.reason
    assert hits((), None) == 0


of_x86_64 = pytest.mark.skipif(platform.machine() != "x86_64", reason="levels of x86-64")


@of_x86_64
@pytest.mark.parametrize(
    ("features", "levels"),
    [
        (",".join(f"+{feature}" for feature in (*LEVELS["x86_64"]["x86-64-v3"], "avx512f")), ["x86-64-v3", "x86-64"]),
        (
            ",".join(f"+{feature}" for feature in LEVELS["x86_64"]["x86-64-v3"] if feature != "avx2") + ",-avx2",
            ["x86-64"],
        ),
        ("", ["x86-64"]),
    ],
)
def test_the_best_level_comes_first_whose_every_feature_the_cpu_has(
    features: str, levels: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for level in (*LEVELS["x86_64"], *LEVELS["aarch64"]):
        (tmp_path / f"0123-{level}").mkdir()
    monkeypatch.setattr(compiled, "FINISHED", tmp_path)
    monkeypatch.setattr(compiled, "get_host_cpu_features", lambda: features)
    monkeypatch.setattr(compiled.numba.config, "CPU_FEATURES", None)
    assert [folder.name for folder in compiled._packaged("0123")] == [f"0123-{level}" for level in levels]
    assert compiled._packaged("4567") == ()


@pytest.mark.parametrize(("machine", "levels"), [("aarch64", ["armv8-a"]), ("riscv64", [])])
def test_each_machine_has_its_own_kernels(
    machine: str, levels: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for level in (*LEVELS["x86_64"], *LEVELS["aarch64"]):
        (tmp_path / f"0123-{level}").mkdir()
    monkeypatch.setattr(compiled, "FINISHED", tmp_path)
    monkeypatch.setattr(compiled, "get_host_cpu_features", lambda: "+neon,+fp-armv8")
    monkeypatch.setattr(compiled.numba.config, "CPU_FEATURES", None)
    monkeypatch.setattr(compiled.platform, "machine", lambda: machine)
    assert [folder.name for folder in compiled._packaged("0123")] == [f"0123-{level}" for level in levels]


@of_x86_64
def test_who_chooses_a_cpu_by_hand_gets_kernels_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "0123-x86-64").mkdir()
    monkeypatch.setattr(compiled, "FINISHED", tmp_path)
    monkeypatch.setattr(compiled.numba.config, "CPU_NAME", "znver3")
    assert compiled._packaged("0123") == ()
