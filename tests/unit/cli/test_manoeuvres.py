"""`uwserver manoeuvres` on a vehicle file of one's own."""

from __future__ import annotations

import json
from pathlib import Path

from click.testing import CliRunner
from manoeuvre_rig import TORPEDO, written

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
