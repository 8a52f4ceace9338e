"""The scenario that `uwserver new` writes: it loads and runs as it is, whatever its name."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from uwserver.scenario.authoring.starter import starter
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def test_it_loads_without_a_warning_and_runs(tmp_path: Path, adapters) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(starter("mine", "bluerov2_heavy"), encoding="utf-8")
    resolved = load(path, adapters=adapters)
    assert resolved.warnings == ()
    world = build(resolved)
    samples = world.step(24)
    assert {"rov/mocap", "rov/truth/pose"} <= {sample.port for sample in samples} | set(world.ports)
    assert any(sample.port == "rov/mocap" for sample in samples)


@pytest.mark.parametrize("name", ["mine", "my tank", 'say "hi"', "back\\slash", "ünïcode", "{vehicle}", "100%"])
def test_the_name_is_the_title(name: str) -> None:
    assert tomllib.loads(starter(name, "bluerov2_heavy"))["title"] == name


@pytest.mark.parametrize("vehicle", ["bluerov2", "./mine.toml", "C:\\rov.toml", "sub folder/mine ü.toml"])
def test_the_vehicle_is_any_name_or_path(vehicle: str) -> None:
    raw = tomllib.loads(starter("mine", vehicle))
    assert raw["vehicles"]["rov"]["model"] == vehicle


def test_it_names_itself_in_the_commands_that_it_tells() -> None:
    text = starter("pool_3", "bluerov2")
    assert "#   uwserver check pool_3.toml " in text
    assert "#   uwserver run pool_3.toml " in text


def test_what_is_commented_out_is_right_too(tmp_path: Path, adapters) -> None:
    text = starter("mine", "bluerov2_heavy")
    text = text.replace("# [vehicles.rov.override.rigid_body]\n# mass", "[vehicles.rov.override.rigid_body]\nmass")
    (tmp_path / "mine.toml").write_text(text)
    vehicle = load(tmp_path / "mine.toml", adapters=adapters).vehicles["rov"].vehicle
    assert vehicle.rigid_body.mass_kg == 14.0


def test_lines_are_short_enough_to_read() -> None:
    assert max(map(len, starter("mine", "bluerov2").splitlines())) <= 120
