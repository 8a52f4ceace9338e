"""What would not fit into memory is refused before an engine asks for it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.solids import memory
from uwserver.scenario.solids.memory import FEW_TRIANGLES, RESERVE_BYTES, TRIANGLE_BYTES, check_memory, free_bytes

GIGABYTE = 10**9


def grid(folder: Path, rows: int, columns: int) -> Path:
    """A scenario on a flat grid; the file has holes and takes no place on the disk."""
    bed = folder / "bed.npy"
    with bed.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": (rows, columns)})
        file.truncate(file.tell() + 4 * rows * columns)
    path = folder / "scenario.toml"
    path.write_text('schema = 1\n[seabed]\nkind = "grid"\nfile = "bed.npy"\nspacing_m = [1.0, 1.0]\n')
    return path


def test_what_fits_is_taken_and_what_does_not_is_refused_with_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "free_bytes", lambda: 2 * GIGABYTE)
    most = (2 * GIGABYTE - RESERVE_BYTES) // TRIANGLE_BYTES
    check_memory("a.npy", most)
    with pytest.raises(BadSolid, match=r'"a.npy" has \d+ triangles, which need 2.0 GB of memory, but 2.0 GB are free'):
        check_memory("a.npy", most + 1)


@pytest.mark.parametrize("free", [None, 0])
def test_few_triangles_are_not_asked_about_nor_where_nobody_tells(
    free: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "free_bytes", lambda: free)
    check_memory("a.npy", FEW_TRIANGLES)
    if free is None:
        check_memory("a.npy", 10**9)


def test_a_container_has_its_own_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    most, used = tmp_path / "max", tmp_path / "current"
    monkeypatch.setattr(memory, "_GROUPS", ((str(most), str(used)),))
    alone = free_bytes()
    most.write_text("1000000\n")
    used.write_text("400000\n")
    assert free_bytes() == 600_000
    most.write_text("max\n")
    assert (free_bytes() is None) == (alone is None)


@pytest.mark.parametrize("kind", ["npy", "together"])
def test_a_scenario_that_does_not_fit_is_refused_at_its_key(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = grid(tmp_path, 300, 300)
    if kind == "together":
        # Each file alone fits.
        monkeypatch.setattr("uwserver.scenario.solids.bathymetry.check_memory", lambda *_: None)
    load(path, adapters={})
    monkeypatch.setattr(memory, "free_bytes", lambda: 400_000_000)
    with pytest.raises(ScenarioError, match=r"seabed: .* triangles, which need 0.4 GB of memory") as caught:
        load(path, adapters={})
    assert len(caught.value.problems) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space")
def test_a_process_with_little_memory_says_so_and_does_not_crash(tmp_path: Path) -> None:
    """An engine that gets none crashed it, after some minutes."""
    code = (
        "import resource, sys\nimport uwserver\nfrom uwserver.scenario.files.errors import ScenarioError\n"
        "resource.setrlimit(resource.RLIMIT_AS, (3 * 10**9, 3 * 10**9))\n"
        "try:\n    uwserver.load(sys.argv[1])\n"
        "except ScenarioError as error:\n    print(error)\n"
    )
    run = [sys.executable, "-c", code, str(grid(tmp_path, 2000, 2000))]
    done = subprocess.run(run, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "8000000 triangles, which need 6.7 GB of memory" in done.stdout
