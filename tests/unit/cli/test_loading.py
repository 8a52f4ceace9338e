"""Loading of a command's scenario, and changed copies of it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from uwserver.cli import main
from uwserver.cli.loading import loaded, require_kind, require_packages, with_adapter, with_changes
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.load.extras import Missing


def test_faults_are_printed_and_end_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        loaded("bluerov2_pol")
    assert ended.value.code == 1
    assert 'did you mean "bluerov2_pool"' in capsys.readouterr().err


def test_a_changed_copy_leaves_the_scenario_as_it_is() -> None:
    resolved, kinds = loaded("bluerov2_pool")
    before = dict(resolved.scenario.adapters)
    another = with_adapter(resolved, "more", kinds["sockets"](port=0))
    assert list(another.scenario.adapters) == [*before, "more"]
    assert with_changes(another, adapters={}).scenario.adapters == {}
    assert resolved.scenario.adapters == before


def test_a_missing_package_ends_the_command() -> None:
    resolved, _ = loaded("bluerov2_pool")
    require_packages(resolved)
    with pytest.raises(
        click.ClickException,
        match="bluerov2_pool: not installed: scipy; install all that this scenario needs: pip install scipy",
    ):
        require_packages(replace(resolved, missing=Missing(("scipy",), "pip install scipy")))


@pytest.mark.parametrize("reference", ["remus100", "crab.toml"])
def test_a_vehicle_is_put_into_a_tank(
    reference: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("crab.toml").write_text(shipped("vehicles")["remus100"].read_text())
    resolved, _ = loaded(reference)
    assert resolved.name == f"{Path(reference).stem} in a tank"
    assert resolved.vehicles["rov"].vehicle.name == "remus100"
    assert [config.__struct_config__.tag for config in resolved.scenario.adapters.values()] == ["sockets"]
    assert capsys.readouterr().err == (
        f"{reference} is a vehicle, so it is put into a tank; `uwserver new NAME --vehicle {reference}` writes this scenario\n"
    )


def test_a_wrong_vehicle_is_told_with_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("crab.toml").write_text(shipped("vehicles")["remus100"].read_text().replace("mass_kg", "mas_kg", 1))
    with pytest.raises(SystemExit):
        loaded("crab.toml")
    assert re.search(r'crab.toml:\d+:1: .*"mas_kg"', capsys.readouterr().err)


def test_another_file_than_the_needed_one_is_told(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text("a: 1")
    with pytest.raises(click.ClickException, match="a recording is needed, and this is a YAML file") as caught:
        require_kind(file, "a recording", "recording", status=2)
    assert caught.value.exit_code == 2
    require_kind(file, "a YAML file", "yaml")
    require_kind(tmp_path / "nothing", "a recording", "recording")


@pytest.mark.parametrize(
    "command",
    [["replay"], ["play"], ["log"], ["export", "--to", "csv"], ["plot", "report"], ["compare", "b.mcap"]],
    ids=lambda command: command[0],
)  # fmt: skip
def test_commands_for_recordings_say_what_a_scenario_is(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tank.toml").write_text("schema = 1\n[vehicles.rov]\nmodel = 'otter'\n")
    result = CliRunner().invoke(main, [*command, "tank.toml"])
    assert result.exit_code == (2 if command[0] == "compare" else 1)
    assert result.output.endswith("is needed, and this is a scenario: `uwserver run tank.toml` runs it\n")
