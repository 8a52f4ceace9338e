"""Kernels by numba's public means alone: the same results, kept by numba's own cache, compiled anew when any source has changed.

Also of uwserver.physics.kernel.sharing without threads.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from uwserver.physics.kernel.choice import is_plain
from uwserver.physics.kernel.plain import made_of

KERNELS = """
import numpy as np
from uwserver.physics.kernel.calling import call_for_float
from uwserver.physics.kernel.compiled import compiled, entry, inlined, separate, cache_state
from uwserver.physics.kernel.sharing import share
from uwserver.physics.kernel.straight import address_of, straight
from uwserver.physics.kernel.team import ALONE, why_alone

@inlined
def at(rows, k):
    return rows[k]

@separate
def cube(x):
    return x * x * x

@compiled
def fill(first, end, me, rows, factor, nothing):
    for i in range(first, end):
        rows[i] = factor * cube(at(rows, i))

@entry
def fill_all(team, rows, factor):
    share(team, fill, (rows, factor, None), len(rows), 2)

@entry
def total(rows):
    return rows.sum()

@entry
def total_there(code, rows):
    return call_for_float(code, (rows,))
"""
CALL = """
import numba
numbers = np.arange(5.0)
before = numba.config.CACHE_DIR
fill_all(ALONE, numbers, 2.0)
total.load(numbers)
print(*numbers, straight(total)(numbers), total_there(address_of(total, "float64"), numbers))
print(sum(fill_all.stats.cache_hits.values()), numba.config.CACHE_DIR == before, cache_state.missing(("mine.total+0", "mine.other")))
print(why_alone())
from numba.core.registry import CPUDispatcher
print(type(total) is type(fill) is CPUDispatcher)
"""


def run(folder: Path) -> list[str]:
    """What a process says that imports these kernels as a module of ours."""
    program = (
        "import uwserver, sys\nuwserver.__path__.append('.')\nfrom uwserver.mine import *\nfrom uwserver.mine import np, ALONE, share\n"
        + CALL
    )
    given = {"UWSERVER_KERNELS": "plain", "NUMBA_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | given, cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_plain_kernels_do_the_same_and_are_kept(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(KERNELS)
    numbers = "0.0 2.0 16.0 54.0 128.0 200.0 200.0"
    lonely = "kernels are plain (UWSERVER_KERNELS)"
    assert run(tmp_path) == [numbers, "0 True ('mine.other',)", lonely, "True"]
    assert run(tmp_path) == [numbers, "1 True ('mine.other',)", lonely, "True"]
    (folder,) = (tmp_path / "cache").iterdir()
    assert folder.name.startswith("kernels-plain-")


def test_an_unknown_choice_of_kernels_is_an_error() -> None:
    assert [is_plain(choice) for choice in (None, "", "plain")] == [False, False, True]
    with pytest.raises(ValueError, match='UWSERVER_KERNELS is "Plain": set it to'):
        is_plain("Plain")
    command = [sys.executable, "-c", "import uwserver.physics.kernel.plain"]
    done = subprocess.run(
        command, env=os.environ | {"UWSERVER_KERNELS": "Plain"}, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        'ValueError: the environment variable UWSERVER_KERNELS is "Plain": set it to "plain" for kernels by the public means of numba alone, '
        "or unset it for the usual kernels; there are no other values"
    )


def test_an_edit_of_any_source_names_another_folder(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    for name in ("a.py", "inner/b.py"):
        (tmp_path / name).write_text("x = 1\n")
    first = made_of(tmp_path)
    assert made_of(tmp_path) == first
    (tmp_path / "inner/b.py").write_text("x = 2\n")
    assert made_of(tmp_path) != first


FALLING = """
from uwserver.scenario.load.scenario import load
from uwserver.adapter import installed_adapters
from uwserver.scenario.build.world import build
world = build(load("{scenario}", adapters=installed_adapters()))
world.step(500)
print(world.call("world/state_hash"))
"""


@pytest.mark.slow
def test_whole_worlds_are_the_same_bit_for_bit(tmp_path: Path) -> None:
    """All kernels that they need are compiled once, without anything private: some ten minutes of one core."""
    for scenario in ("rov_autopilot", "slope"):
        said = []
        for kernels in ("", "plain"):
            given = {"UWSERVER_KERNELS": kernels, **({"NUMBA_CACHE_DIR": str(tmp_path)} if kernels else {})}
            done = subprocess.run(
                [sys.executable, "-c", FALLING.format(scenario=scenario)], env=os.environ | given, capture_output=True, text=True, timeout=1500
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            said.append(done.stdout)
        assert said[0] == said[1]
