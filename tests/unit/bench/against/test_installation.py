"""Another installation is found by its folder, and sees nothing of ours."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from uwserver_bench.against.installation import Installation, ours, theirs
from uwserver_bench.processes import BenchFailed

import uwserver


def test_ours_tells_where_it_is(tmp_path: Path) -> None:
    facts = ours().facts(tmp_path)
    assert Path(str(facts["folder"])) == Path(uwserver.__file__).parent
    assert facts["packages"]["uwserver"] == uwserver.__version__
    assert facts["distributions"] > 5


def test_a_folder_without_python_is_refused_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(BenchFailed, match="python -m venv"):
        theirs(tmp_path)


def test_our_search_path_does_not_leak_into_theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere/of/ours")
    monkeypatch.setenv("PYTHONHASHSEED", "1")
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").touch()
    environment = theirs(tmp_path).environment
    assert not [name for name in environment if name.startswith("PYTHON")]
    assert environment["HOME"] == str(tmp_path)


def test_a_python_without_uwserver_is_told(tmp_path: Path) -> None:
    bare = Installation("theirs", sys.executable, {"PYTHONPATH": "", "PYTHONNOUSERSITE": "1", "PYTHONHOME": "/nowhere"})
    with pytest.raises(BenchFailed, match="cannot import uwserver"):
        bare.facts(tmp_path)
