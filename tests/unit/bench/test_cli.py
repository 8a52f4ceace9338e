"""Options of `uwserver bench` that do not go together, and its exit status."""

from __future__ import annotations

import json
import pkgutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from uwserver_bench import cli
from uwserver_bench.against import compare
from uwserver_bench.against.figures import Comparison, Figure
from uwserver_bench.processes import BenchFailed

FACTS = {"folder": "/a", "python": "3", "packages": {}, "distributions": 1}


def result(ratio: float) -> Comparison:
    figure = Figure("ticks", "a tick", "us", (ratio,) * 15, (1.0,) * 15)
    return Comparison(False, 15, {}, {"ours": FACTS, "theirs": FACTS}, (figure,))


@pytest.mark.parametrize(("ratio", "status"), [(1.0, 0), (2.0, 1)])
def test_a_worse_figure_is_the_exit_status(
    ratio: float, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare, "compare", lambda *_: result(ratio))
    file = tmp_path / "report.json"
    done = CliRunner().invoke(cli.bench, ["--against", str(tmp_path), "--json", str(file)])
    assert done.exit_code == status, done.output
    assert "a tick" in done.output
    assert json.loads(file.read_text())["format"] == "uwserver-bench-against-1"


@pytest.mark.parametrize(
    ("options", "pairs"), [([], compare.PAIRS), (["--quick"], compare.QUICK_PAIRS), (["--quick", "--pairs", "7"], 7)]
)
def test_how_many_pairs(options: list[str], pairs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(compare, "compare", lambda venv, pairs, *_: asked.append(pairs) or result(1.0))
    assert CliRunner().invoke(cli.bench, ["--against", str(tmp_path), *options]).exit_code == 0
    assert asked == [pairs]
    assert compare.PAIRS >= 15


def test_a_failure_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> Comparison:
        raise BenchFailed("theirs: no answer")

    monkeypatch.setattr(compare, "compare", fail)
    done = CliRunner().invoke(cli.bench, ["--against", str(tmp_path)])
    assert done.exit_code == 1
    assert "theirs: no answer" in done.output


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["physiks"], "physics"),
        (["physics", "--against", "."], "--only"),
        (["--pairs", "3"], "--against"),
        (["--only", "tick"], "--against"),
        (["--against", "no_such_folder"], "no_such_folder"),
        (["--against", ".", "--pairs", "0"], "--pairs"),
    ],
)
def test_what_makes_no_sense_is_refused(options: list[str], text: str) -> None:
    done = CliRunner().invoke(cli.bench, options)
    assert done.exit_code == 2
    assert text in done.output


def test_each_part_has_its_function() -> None:
    for name in cli.PARTS:
        for place in cli._BENCHES[name]:
            assert callable(pkgutil.resolve_name(f"uwserver_bench.{place}"))
