"""`uwserver bench --against` measures all its figures of two versions; here both are this one. Speed is never judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

PATIENCE_S = 600
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def venv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder like a virtual environment, whose Python runs this version without PYTHONPATH."""
    folder = tmp_path_factory.mktemp("venv")
    python = folder / "bin" / "python"
    python.parent.mkdir()
    path = ":".join(str(Path(entry).absolute()) for entry in sys.path)
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{path}" exec "{sys.executable}" "$@"\n', encoding="utf-8")
    python.chmod(0o755)
    return folder


@pytest.fixture(scope="module")
def run(venv: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, subprocess.CompletedProcess]:
    file = tmp_path_factory.mktemp("bench") / "against.json"
    command = [sys.executable, "-m", "uwserver", "bench", "--against", str(venv), "--quick", "--json", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert file.exists(), done.stdout + done.stderr
    return json.loads(file.read_text()), done


def test_every_figure_has_a_pair_of_positive_values_and_one_pair_never_says_worse(run) -> None:
    """Progress goes to stderr and the table to stdout."""
    report, done = run
    assert report["format"] == "uwserver-bench-against-1"
    assert report["quick"] is True
    for figure in report["figures"]:
        assert len(figure["ours"]) == len(figure["theirs"]) == report["pairs"], figure["name"]
        assert min(*figure["ours"], *figure["theirs"]) > 0.0, figure["name"]
        assert figure["name"] in done.stdout
    assert {figure["verdict"] for figure in report["figures"]} <= {"few", "ok", "both miss"}
    assert done.returncode == 0
    assert len({facts["folder"] for facts in report["versions"].values()}) == 1
    assert "same installation" in done.stdout
    assert "pair 1 of" in done.stderr
    assert "pair 1 of" not in done.stdout


def test_all_that_must_not_get_slower_is_among_them(run) -> None:
    names = "\n".join(figure["name"] for figure in run[0]["figures"])
    wanted = [
        "import uwserver", "uwserver check", "load 1 vehicle", "load 20 with navigation", "tick of 1 BlueROV2", "tick of 20 BlueROV2",
        "tick of 100 BlueROV2", "tick of 1 with navigation", "tick of 20 with navigation", "push crates", "scanning sonar",
        "snapshot and its hash", "TCP JSON", "TCP msgpack", "MOOS", "start to the first sample", "memory",
    ]  # fmt: skip
    wanted += ["MAVLink"] if find_spec("pymavlink") else []
    assert [name for name in wanted if name not in names] == []


def test_what_has_a_bar_of_its_own_is_judged_by_it(run) -> None:
    """Latencies, and the import, which may take 30 ms."""
    bars = {figure["name"]: figure["bar"] for figure in run[0]["figures"] if figure["group"] != "latencies"}
    judged = {name: bar for name, bar in bars.items() if bar is not None}
    assert judged == {"`import uwserver`, beyond the bare interpreter": 30.0}
