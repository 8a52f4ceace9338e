"""`uwserver manoeuvres` and `uwserver plot vehicle` on a vehicle file of one's own."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.image
import pytest
from click.testing import CliRunner
from manoeuvre_rig import ROV, TORPEDO, written

from uwserver.cli import main


def test_the_report_is_a_page_or_json(tmp_path: Path) -> None:
    file = str(written(tmp_path, TORPEDO))
    page = CliRunner().invoke(main, ["manoeuvres", file, "--density", "1000"])
    assert page.exit_code == 0
    assert page.output.startswith("# craft\n")
    assert "In water of 1000 kg/m3" in page.output
    tree = json.loads(CliRunner().invoke(main, ["manoeuvres", file, "--json"]).output)
    assert (tree["name"], tree["density_kgpm3"]) == ("craft", 1025.0)


def test_a_fault_is_told_with_its_place(tmp_path: Path) -> None:
    file = written(tmp_path, TORPEDO | {"published": [{"quantity": "beauty", "value": 1.0}]})
    done = CliRunner().invoke(main, ["manoeuvres", str(file)])
    assert done.exit_code == 1
    assert "craft.toml" in done.output
    assert "published" in done.output
    assert "ahead_speed_mps" in done.output


@pytest.mark.parametrize("raw", [ROV, TORPEDO])
def test_a_vehicle_is_drawn(tmp_path: Path, raw: dict[str, object]) -> None:
    picture = tmp_path / "drawn.png"
    done = CliRunner().invoke(main, ["plot", "vehicle", str(written(tmp_path, raw)), "-o", str(picture)])
    assert (done.exit_code, done.output) == (0, f"wrote {picture}\n")
    image = matplotlib.image.imread(picture)
    red = (image[..., 0] > 0.7) & (image[..., 1] < 0.4)
    assert red.sum() > 100, "thrust is drawn"


def test_no_picture_of_a_vehicle_that_there_is_not(tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["plot", "vehicle", "nothing", "-o", str(tmp_path / "x.png")])
    assert done.exit_code == 1
    assert 'unknown vehicle "nothing"' in done.output
