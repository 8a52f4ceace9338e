"""The notebooks under docs/notebooks run from top to bottom, and find what they say; their outputs are not kept."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Runs the code of a notebook as Jupyter does, cell after cell in one namespace; returns that, and the pictures that it draws."""
    matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)

    def run_notebook(name: str) -> tuple[dict[str, Any], int]:
        cells = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
        assert not any(cell.get("outputs") for cell in cells)
        space: dict[str, Any] = {}
        for cell in cells:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), f"{name}:{cell['id']}", "exec"), space)
        pictures = len(plt.get_fignums())
        for number in plt.get_fignums():
            plt.figure(number).savefig(tmp_path / f"{name}_{number}.png")
        plt.close("all")
        return space, pictures

    return run_notebook


def test_the_first_dive_holds_depth_and_heading(run):
    space, pictures = run("first_dive")
    depth, ahrs = space["depth"], space["ahrs"]
    assert np.abs(depth.depth[depth.t > 35] - space["DEPTH_M"]).max() < 0.05
    assert np.abs(ahrs.heading[ahrs.t > 35] - space["HEADING"]).max() < 0.1
    assert pictures == 1


def test_the_drag_that_is_found_is_that_of_the_file(run):
    space, pictures = run("drag_from_a_decay_test")
    assert space["linear"] == pytest.approx(4.03, rel=0.03)
    assert space["quadratic"] == pytest.approx(34.6, rel=0.03)
    assert pictures == 1


def test_the_sonar_sees_the_walls(run):
    space, pictures = run("sonar_picture")
    echo = space["echo"]
    assert len(echo) > 90
    assert echo.max() > 100
    assert np.ptp(space["angle"]) > 6.0
    assert pictures == 1


def test_the_best_filter_lies_between_noise_and_delay(run):
    space, pictures = run("filter_tuning")
    assert 0.05 < space["best"] < 2.0
    assert min(space["errors"]) < 0.5 * space["errors"][0]
    assert min(space["errors"]) < space["errors"][-1]
    assert pictures == 1


def test_every_notebook_is_run():
    here = Path(__file__).read_text(encoding="utf-8")
    names = [path.stem for path in FOLDER.glob("*.ipynb")]
    assert len(names) >= 4
    assert not [name for name in names if f'run("{name}")' not in here]
