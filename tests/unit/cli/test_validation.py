"""The commands `validate` and `manoeuvres`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click import Context
from click.testing import CliRunner
from manoeuvre_rig import TORPEDO, written

from uwserver.cli import main
from uwserver.cli.validation import validate

ORACLES = Path(__file__).parents[2] / "physics" / "oracles"
SPHEROID = str(ORACLES / "spheroid_1.json")


def test_table_has_a_line_for_each_file() -> None:
    result = CliRunner().invoke(validate, [SPHEROID, str(ORACLES / "spheroid_3.json"), "--rate-hz", "1000"])
    assert result.exit_code == 0
    head, first, second = result.output.splitlines()
    assert head.split()[:3] == ["file", "rate", "Hz"]
    assert first.split()[:2] == ["spheroid_1.json", "1000"]
    assert second.startswith("spheroid_3.json")
    assert float(first.split()[2]) < 1e-6


def test_json_is_for_programs() -> None:
    result = CliRunner().invoke(validate, [SPHEROID, "--json"])
    (entry,) = json.loads(result.output)
    assert entry["file"] == SPHEROID
    assert 0.0 < entry["position_m"] < 1e-6
    assert entry["position_at_s"] == 1.0
    assert (entry["rate_hz"], entry["samples"], entry["steps"]) == (240.0, 2, 240)


def test_unreadable_files_fail_by_name_and_the_others_still_run(tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    other.write_text('{"format": "something"}')
    result = CliRunner().invoke(validate, [str(other), SPHEROID, str(tmp_path / "absent.json")])
    assert result.exit_code == 1
    assert 'format "something" found, "uwserver-oracle-1" expected' in result.stderr
    assert "absent.json: No such file" in result.stderr
    assert "spheroid_1.json" in result.stdout


def test_a_rate_of_zero_is_refused() -> None:
    result = CliRunner().invoke(validate, [SPHEROID, "--rate-hz", "0"])
    assert result.exit_code == 2
    assert "--rate-hz" in result.stderr


def test_it_is_exported_to_the_command_line() -> None:
    assert main.get_command(Context(main), "validate") is validate


def test_the_report_is_a_page_or_json(tmp_path: Path) -> None:
    file = str(written(tmp_path, TORPEDO))
    page = CliRunner().invoke(main, ["manoeuvres", file, "--density", "1000"])
    assert page.exit_code == 0
    assert page.output.startswith("# craft\n")
    assert "In water of 1000 kg/m3" in page.output
    tree = json.loads(CliRunner().invoke(main, ["manoeuvres", file, "--json"]).output)
    assert (tree["name"], tree["density_kgpm3"]) == ("craft", 1025.0)


def test_a_terminal_gets_aligned_tables_and_markdown_on_request(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(written(tmp_path, TORPEDO))
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "90")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    for options, begins in (((), "craft\nA box.\n\nVerdict\n"), (("--markdown",), "# craft\n")):
        main(["manoeuvres", file, *options], standalone_mode=False)
        shown = capsys.readouterr().out
        assert shown.startswith(begins)
        assert ("|" in shown) == bool(options)


def test_a_fault_is_told_with_its_place(tmp_path: Path) -> None:
    file = written(tmp_path, TORPEDO | {"published": [{"quantity": "beauty", "value": 1.0}]})
    done = CliRunner().invoke(main, ["manoeuvres", str(file)])
    assert done.exit_code == 1
    assert "craft.toml" in done.output
    assert "published" in done.output
    assert "ahead_speed_mps" in done.output
