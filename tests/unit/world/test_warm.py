"""The kernel cache: warmed once, read where it cannot be written, and cleared of old versions."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

from uwserver.physics.dynamics import integrator
from uwserver.physics.kernel.compiled import cache_state, cpu_of
from uwserver.world import World
from uwserver.world.builds import STAGES, kernels_of
from uwserver.world.warm import prune, warm

# Root may write anywhere, so the read-only folder is one that says it is.
READ_ONLY = """
import os, sys
access = os.access
os.access = lambda path, mode, **options: mode != os.W_OK and access(path, mode, **options)
from uwserver.physics.kernel.compiled import cache_state
from uwserver.world.warm import warm
print(cache_state.reason, warm())
"""


def read_only_run(folder: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", READ_ONLY], env={**os.environ, "NUMBA_CACHE_DIR": str(folder), **environment},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    """A copy of the finished cache."""
    if cache_state.folder is None or cache_state.reason:
        pytest.skip(f"no cache of its own here: {cache_state.reason}")
    warm()
    shutil.copytree(cache_state.folder, tmp_path / cache_state.folder.name)
    return tmp_path


def test_warming_leaves_nothing_to_compile_for_a_world(world: World) -> None:
    lines: list[str] = []
    warm(lines.append)
    assert len(lines) == 9
    names = "advance", "rates_of_change", "advance_fitted", "rates_of_change_fitted"
    kernels: tuple[Any, ...] = tuple(getattr(integrator, name) for name in names)
    before = [len(kernel.signatures) for kernel in kernels]
    world.step(20)
    assert [len(kernel.signatures) for kernel in kernels] == before == [1, 1, 1, 1]


def test_a_finished_cache_serves_where_nothing_can_be_written(finished: Path) -> None:
    files = sorted((path, path.stat().st_mtime_ns) for path in finished.rglob("*"))
    assert all(
        any(path.name.startswith(kernel) for path, _ in files) for stage in STAGES for kernel in kernels_of(stage)
    )
    assert read_only_run(finished) == "read-only False"
    assert sorted((path, path.stat().st_mtime_ns) for path in finished.rglob("*")) == files


EVERYTHING = """
import uwserver
from uwserver.physics.collision import broad_phase, narrow_phase
from uwserver.physics.contact import step
from uwserver.physics.dynamics import integrator
from uwserver.physics.kernel.numba_private.caches import EntryCache

made = []
EntryCache.save_overload = lambda cache, sig, data: made.append(cache._kernel)
kernels = integrator.advance_fitted, step.strike_fitted, step.finish_contacts, broad_phase.find_pairs, narrow_phase.find_contacts
world = uwserver.load("slope").core
loaded = [len(kernel.signatures) for kernel in kernels]
world.step(30)
print(loaded == [len(kernel.signatures) for kernel in kernels], len(world.hydro.touched.impulse) > 0)
for name in ("bluerov2_qgc", "one_of_everything", "remus_survey"):
    world = uwserver.load(name)
    world.step(200)
print(made)
"""


def test_a_second_process_compiles_nothing(finished: Path) -> None:
    """Neither of physics, nor of sensors, their errors, or autopilots; and no tick waits for a kernel where fins and contacts meet.

    In a process of its own: what an earlier test loaded would hide it.
    """
    files = sorted(path.name for path in finished.rglob("*"))
    done = subprocess.run(
        [sys.executable, "-c", EVERYTHING],
        env={**os.environ, "NUMBA_CACHE_DIR": str(finished)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.stdout.split() == ["True", "True", "[]"], done.stderr
    assert sorted(path.name for path in finished.rglob("*")) == files


def test_another_cpu_has_another_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    """So what a machine cannot run is not even looked at."""
    names = set()
    for cpu in ("generic", "x86-64-v3", ""):
        monkeypatch.setattr(numba.config, "CPU_NAME", cpu)
        names.add(cpu_of())
    assert len(names) == 3


def test_prune_removes_the_oldest_of_other_versions_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uwserver.world.warm._KEPT", 4)
    names = [f"kernels-{letter}" for letter in "abcdefg"]
    for age, name in enumerate((*names, "elsewhere")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text("")
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    assert prune(tmp_path / "kernels-f") == [tmp_path / "kernels-e", tmp_path / "kernels-g"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere", *names[:4], "kernels-f"]
