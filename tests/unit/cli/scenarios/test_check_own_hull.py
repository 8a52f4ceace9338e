"""What check tells of sonars that look at their own vehicle."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

import uwserver.cli.scenarios.check as commands
from uwserver.cli.scenarios.check import blocked, facing_their_hull
from uwserver.physics.geometry.shapes import Box, Placed, Solid
from uwserver.scenario.load.scenario import load
from uwserver.sensors import BathymetryConfig, MultibeamConfig, Pose

SONAR = """schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
copies = {{ count = 2 }}
[vehicles.rov.sensors.sonar]
kind = "multibeam"
profile = "oculus_m750d"
rate_hz = 10
range_m = 20
rpy_deg = [0.0, -10.0, 0.0]
position_frd_m = {position}
{more}
"""
HULL = Solid("hull", (Placed(Box((0.5, 0.5, 0.5))),))


def lines(folder: Path, position: list[float], more: str = "sees_own_vehicle = true") -> list[str]:
    path = folder / "sonar.toml"
    path.write_text(SONAR.format(position=position, more=more), encoding="utf-8")
    return list(facing_their_hull(load(path, adapters={})))


def test_a_sonar_on_the_lid_of_its_hull_is_told(tmp_path: Path) -> None:
    """3 mm above the middle box of a BlueROV2, which ends at -0.097 m: copies of the vehicle are told once."""
    (line,) = lines(tmp_path, [0.2, 0.0, -0.1])
    assert line.startswith("own hull: rov_1/sonar at [0.2, 0, -0.1] looks at its own vehicle: ")
    assert "the nearest 0.0" in line
    assert "position_frd_m" in line


@pytest.mark.parametrize("position", [[0.25, 0.0, 0.1], [0.3, 0.0, -0.1], [0.2, 0.0, 0.0]])
def test_one_in_front_of_it_or_inside_is_not(tmp_path: Path, position: list[float]) -> None:
    assert lines(tmp_path, position) == []


def test_one_that_looks_through_its_vehicle_is_not(tmp_path: Path) -> None:
    assert lines(tmp_path, [0.2, 0.0, -0.1], "") == []


def test_a_profiler_whose_head_turns_is_not_judged(tmp_path: Path) -> None:
    path = tmp_path / "sonar.toml"
    text = SONAR.format(position=[0.2, 0.0, -0.1], more="sees_own_vehicle = true")
    path.write_text(
        text.replace('"multibeam"', '"profiler"').replace('profile = "oculus_m750d"\n', ""), encoding="utf-8"
    )
    assert list(facing_their_hull(load(path, adapters={}))) == []


def test_the_part_of_the_power_that_is_lost() -> None:
    """Ahead of a box that is turned away from: none. Behind it: all. Above its edge, half the field of a sonar that looks along it."""
    sonar = MultibeamConfig(rate_hz=10)
    assert blocked(sonar, Pose((0.6, 0.0, 0.0)), HULL) == (0.0, float("inf"))
    share, nearest = blocked(sonar, Pose((-0.6, 0.0, 0.0)), HULL)
    assert share > 0.9
    assert nearest == pytest.approx(0.1, abs=0.002)
    share, _ = blocked(sonar, Pose((-0.5, 0.0, -0.5001)), HULL)
    assert share == pytest.approx(0.5, abs=0.05)


def test_axes_of_a_sonar_that_looks_down_count() -> None:
    assert blocked(BathymetryConfig(rate_hz=1), Pose((0.0, 0.0, 0.6)), HULL)[0] == 0.0
    assert blocked(BathymetryConfig(rate_hz=1), Pose((0.0, 0.0, -0.6)), HULL)[0] > 0.9


def test_check_prints_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "installed_adapters", dict)
    lines(tmp_path, [0.2, 0.0, -0.1])
    result = CliRunner().invoke(commands.check, [str(tmp_path / "sonar.toml")])
    assert result.exit_code == 0
    assert "\nown hull: rov_1/sonar" in result.stderr
