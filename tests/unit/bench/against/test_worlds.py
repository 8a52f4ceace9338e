"""Worlds of two versions beside each other: what is asked for alone is measured, whatever else it needs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from uwserver_bench.against.installation import ours
from uwserver_bench.against.pairs import Pairs
from uwserver_bench.against.worlds import Worlds


@pytest.mark.parametrize("only", ["restore", pytest.param("tick of 1 BlueROV2", marks=pytest.mark.slow)])
def test_a_figure_can_be_measured_alone(only: str, tmp_path: Path) -> None:
    versions = {"ours": ours(), "theirs": replace(ours(), side="theirs")}
    pairs = Pairs(only)
    Worlds(versions, tmp_path, quick=True).measure(0, pairs)
    (figure,) = pairs.figures({"ticks": 0, "state": 1, "loading": 2})
    assert only in figure.name
    assert len(figure.ours) == len(figure.theirs) == 1
    assert min(figure.ours + figure.theirs) > 0.0
