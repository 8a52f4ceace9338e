"""The name of the kernel cache: it follows the files that decide what a kernel does, and no others."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import uwserver
from uwserver.physics.kernel.compiled import cache_state, kernel_sources, made_of

PACKAGE = Path(uwserver.__file__).parent


@pytest.fixture
def physics(tmp_path: Path) -> Path:
    """A copy of the sources, to be edited."""
    ignore = shutil.ignore_patterns("__pycache__", "finished")
    return shutil.copytree(PACKAGE / "physics", tmp_path / "physics", ignore=ignore)


def test_the_folder_is_named_after_the_sources() -> None:
    assert cache_state.folder is None or cache_state.folder.name.startswith(f"kernels-{made_of(PACKAGE / 'physics')}-")


@pytest.mark.parametrize(
    "kernel", ["dynamics/appendage_forces.py", "contact/solver.py", "rays/hits.py", "kernel/layout.py"]
)
def test_an_edited_kernel_gets_a_new_cache(physics: Path, kernel: str) -> None:
    source = physics / kernel
    source.write_text(source.read_text() + "\nEDITED = 1\n")
    assert made_of(physics) != made_of(PACKAGE / "physics")


def test_a_comment_elsewhere_keeps_the_cache(physics: Path) -> None:
    for source in ("scene.py", "bodies.py", "collision/bullet.py", "dynamics/params.py"):
        path = physics / source
        path.write_text(path.read_text() + "\n# A comment.\n")
    assert made_of(physics) == made_of(PACKAGE / "physics")


def test_what_is_compiled_is_found_with_what_it_imports() -> None:
    physics = PACKAGE / "physics"
    found = {path.relative_to(physics).as_posix() for path in kernel_sources(physics)}
    decorated = {p.relative_to(physics).as_posix() for p in physics.rglob("*.py") if "\n@compiled" in p.read_text()}
    assert decorated <= found
    assert {"kernel/layout.py", "kernel/compiled.py", "rays/raycast.py"} <= found  # constants frozen into kernels
    assert "warm.py" not in found
