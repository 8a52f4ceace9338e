from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
import run_parts

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="needs make")

MAKEFILE = """\
good:
\t@echo ran >> good.log
bad:
\t@echo ran >> bad.log; test -e mended
busy:
\t@python3 -c "sum(range(3_000_000))"
"""
RESULTS = '<testsuites><testsuite tests="5" failures="1" errors="0" skipped="1"/></testsuites>'


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    (tmp_path / "Makefile").write_text(MAKEFILE)
    (tmp_path / ".gitignore").write_text("build\n*.log\n")
    (tmp_path / run_parts.FIGURES).mkdir(parents=True)
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    return tmp_path


def times(checkout: Path, part: str) -> int:
    """How often a part was run."""
    return (checkout / f"{part}.log").read_text().count("ran")


def test_one_fault_does_not_hide_the_others(checkout: Path) -> None:
    runs = run_parts.run_all(["bad", "good"], None, checkout)
    assert [(run.part, run.passed) for run in runs] == [("bad", False), ("good", True)]
    assert "bad" in run_parts.table(runs)
    assert run_parts.table(runs).count("FAILED") == 2  # of the part, and so of all


def test_processors_of_the_part_s_own_processes_are_counted(checkout: Path) -> None:
    run = run_parts.run("busy", checkout)
    assert run.passed
    assert 0.0 < run.cpu_s <= 4.0 * run.wall_s + 1.0


def test_a_run_that_was_broken_off_goes_on_until_a_file_changes(checkout: Path) -> None:
    kept = checkout / "build" / "kept.json"
    run_parts.run_all(["good", "bad"], kept, checkout)
    runs = run_parts.run_all(["good", "bad"], kept, checkout)
    assert [run.passed for run in runs] == [True, False]
    assert (times(checkout, "good"), times(checkout, "bad")) == (1, 2)
    (checkout / "mended").write_text("")
    assert all(run.passed for run in run_parts.run_all(["good", "bad"], kept, checkout))
    assert (times(checkout, "good"), times(checkout, "bad")) == (2, 3)
    (checkout / "another.log").write_text("")  # git ignores it
    run_parts.run_all(["good"], kept, checkout)
    assert times(checkout, "good") == 2


def test_without_git_nothing_is_taken_as_done(checkout: Path) -> None:
    shutil.rmtree(checkout / ".git")
    for _ in range(2):
        run_parts.run_all(["good"], checkout / "build" / "kept.json", checkout)
    assert times(checkout, "good") == 2


def test_tests_are_counted_over_all_parts(checkout: Path) -> None:
    for part in ("one", "two"):
        (checkout / run_parts.FIGURES / f"{part}.xml").write_text(RESULTS)
    assert run_parts.counts(["one", "two", "none"], checkout) == {"passed": 6, "failed": 2, "skipped": 2}
