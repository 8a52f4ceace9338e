from __future__ import annotations

import sys
from pathlib import Path

import faults
import faulty_tree
import pytest

CODE = "def add(a: int, b: int) -> int:\n    return a + b\n"
TESTS = """import sys
from pathlib import Path
sys.path.insert(0, str(Path(__file__).parent))
import sums

def test_nothing(): pass
def test_broken(): assert sums.add(2, 2) == 5
def test_sum(): assert sums.add(2, 3) == 5
"""


@pytest.fixture
def tree(tmp_path: Path):
    """A sum, and tests of it, one of which is wrong."""
    root = tmp_path / "tree"
    root.mkdir()
    (root / "sums.py").write_text(CODE)
    (root / "test_sums.py").write_text(TESTS)
    return faulty_tree.Tree(root, Path(sys.executable), tmp_path / "kernels", [], [])


def fault(old: str, new: str):
    return faulty_tree.Fault("sum", "sums.py", old, new, "The sum is wrong.")


def test_each_fault_of_the_list_fits_the_code():
    """Whoever changes a line in which a fault stands changes the list."""
    assert list(faults.objections()) == []
    assert len(faults.faults()) >= 44


def test_a_fault_is_found_by_a_test_that_passes_without_it(tree):
    trial = tree.tried(fault("a + b", "a - b"), ["test_sums.py"])
    assert (trial.result, trial.by) == ("found", "test_sums.py::test_sum")
    assert tree.broken == ["test_sums.py::test_broken"]
    assert tree.sound == ["test_sums.py::test_sum"]
    assert (tree.root / "sums.py").read_text() == CODE


def test_what_changes_nothing_survives(tree):
    tree.broken.append("test_sums.py::test_broken")
    trial = tree.tried(fault("a + b", "b + a"), ["test_sums.py"])
    assert (trial.result, trial.by) == ("survived", "")


def test_a_file_is_as_before_whatever_happens(tree):
    path = tree.root / "sums.py"
    before = path.stat().st_mtime_ns
    held = tree.holding(fault("a + b", "a * b"))
    held.__enter__()
    assert "a * b" in path.read_text()
    assert not held.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert (path.read_text(), path.stat().st_mtime_ns) == (CODE, before)


def test_a_fault_stands_at_one_place(tree):
    with pytest.raises(SystemExit, match="3 times"), tree.holding(fault("a", "b")):
        pass


def test_each_stage_goes_on_where_it_stopped():
    trial = faulty_tree.Trial
    entry = faults.Entry("key")
    assert faults.is_open("room", entry, "new", False)
    assert not faults.is_open("all", entry, "new", False)
    entry.trials["room"] = trial("survived", commit="old")
    assert not faults.is_open("room", entry, "new", False)
    assert faults.is_open("room", entry, "new", True)
    assert faults.is_open("all", entry, "new", False)
    entry.trials["room"] = trial("found", "test_sums.py::test_sum", commit="new")
    assert not faults.is_open("all", entry, "new", False)
    assert faults.is_open("old", entry, "new", False)
    assert not faults.is_open("room", entry, "new", True)


def test_the_page_tells_what_was_found(tmp_path: Path):
    trial = faulty_tree.Trial
    one, other = fault("a + b", "a - b"), faulty_tree.Fault("other", "sums.py", "a", "b", "Another.")
    outcome = faults.Outcome({one.name: faults.Entry(one.key)})
    outcome.faults[one.name].trials["room"] = trial("found", "tests/unit/test_sums.py::test_sum", 3, "c0ffee")
    outcome.faults[one.name].trials["old"] = trial("survived", "", 3, "c0ffee")
    faults.write_outcome(tmp_path / "outcome.json", outcome)
    text = faults.page([one, other], faults.read_outcome(tmp_path / "outcome.json"))
    assert "Of 2 faults 1 are found now, and 0 were found before." in text
    assert "| The sum is wrong. | `sums.py` | no | yes | `unit/test_sums.py::test_sum` |\n" in text
    assert "| Another. | `sums.py` | not tried | not tried |  |\n" in text


def test_the_page_is_that_of_list_and_outcome():
    if faults.PAGE.is_file():
        assert faults.PAGE.read_text() == faults.page(faults.faults(), faults.read_outcome(faults.OUTCOME))
