"""Worlds of two versions beside each other: what is asked for alone is measured, whatever else it needs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from uwserver_bench.against import worlds
from uwserver_bench.against.installation import Installation, ours
from uwserver_bench.against.pairs import Pairs
from uwserver_bench.against.worlds import Worlds

ORDER = {"ticks": 0, "state": 1, "loading": 2}


class Scripted:
    """A process that needs a millisecond for each task, and refuses one that nothing was prepared for."""

    def __init__(self) -> None:
        self.built: set[str] = set()
        self.loaded: set[str] = set()
        self.kept: set[str] = set()

    def ask(self, do: str, **task: Any) -> float:
        name = task.get("name", "")
        if do == "load":
            assert Path(task["file"]).is_file()
            self.loaded.add(name)
            return 1e-3
        assert name in self.loaded
        for service, _ in task.get("calls", ()):
            if service == "world/snapshot":
                self.kept.add(name)
            assert service != "world/restore" or name in self.kept
        return 1e-3


def alone(only: str, place: Path) -> Pairs:
    """A pair of the figures of this name."""
    versions = {"ours": ours(), "theirs": replace(ours(), side="theirs")}
    pairs = Pairs(only)
    Worlds(versions, place, quick=True).measure(0, pairs)
    return pairs


@pytest.mark.parametrize("only", [*(title for title in worlds.CALLS), *(ticks.kind.name for ticks in worlds.TICKS)])
def test_what_a_figure_needs_is_there_where_it_alone_is_measured(
    only: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextlib.contextmanager
    def probing(version: Installation, place: Path) -> Iterator[Scripted]:
        yield Scripted()

    monkeypatch.setattr(worlds, "probing", probing)
    monkeypatch.setattr(worlds.scenarios, "write_survey", lambda folder: _empty(folder / "survey.toml"))
    (figure,) = alone(only, tmp_path).figures(ORDER)
    assert figure.name == only
    assert figure.ours == figure.theirs


def _empty(file: Path) -> Path:
    file.touch()
    return file


@pytest.mark.slow
@pytest.mark.parametrize("only", ["restore", "tick of 1 BlueROV2"])
def test_a_figure_can_be_measured_alone(only: str, tmp_path: Path) -> None:
    (figure,) = alone(only, tmp_path).figures(ORDER)
    assert only in figure.name
    assert len(figure.ours) == len(figure.theirs) == 1
    assert min(figure.ours + figure.theirs) > 0.0
