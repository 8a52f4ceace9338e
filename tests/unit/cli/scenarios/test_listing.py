"""The parts of a vehicle file, and the calibration of a camera."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from uwserver.cli import main
from uwserver.cli.scenarios.listing import parts_of
from uwserver.scenario.files.documents import shipped


def test_thrusters_are_placed_and_point_somewhere():
    lines = list(parts_of("bluerov2_heavy"))
    assert (
        "thruster   t1                        0.156    0.111    0.040   astern and right (-0.71, 0.71, 0.00)" in lines
    )
    assert [line for line in lines if line.startswith("thruster   t8") and line.endswith("down (0.00, 0.00, 1.00)")]
    assert "sensors: imu (imu), pressure (pressure), depth (pressure)" in lines


def test_fins_and_propellers_are_told():
    text = "\n".join(parts_of("remus100"))
    assert "propeller  main" in text
    assert "fins: rudder, stern_planes" in text


@pytest.mark.parametrize("name", sorted(shipped("vehicles")))
def test_every_shipped_vehicle_can_be_listed(name):
    assert CliRunner().invoke(main, ["list", "vehicles", name]).output.startswith(name)


@pytest.mark.parametrize(
    ("what", "asked", "meant"),
    [("sensors", "sonar", "scanning_sonar"), ("sensors", "presure", "pressure"), ("vehicles", "remus", "remus100")],
)
def test_a_name_that_is_nearly_right_is_guessed(what, asked, meant):
    done = CliRunner().invoke(main, ["list", what, asked])
    assert done.exit_code == 2
    assert f'there is no "{asked}" (did you mean "{meant}"?)' in done.output


def test_a_name_like_nothing_gets_all():
    assert "there are: imu, pressure" in CliRunner().invoke(main, ["list", "sensors", "xyz"]).output


def test_both_forms_and_a_name_that_is_none() -> None:
    done = CliRunner().invoke(main, ["camera-info", "one_of_everything", "heavy/camera"])
    assert done.exit_code == 0, done.output
    assert "camera_name: heavy_camera" in done.stdout
    done = CliRunner().invoke(main, ["camera-info", "one_of_everything", "heavy/ranger", "--form", "opencv"])
    assert done.stdout.startswith("%YAML:1.0")
    done = CliRunner().invoke(main, ["camera-info", "one_of_everything", "heavy/camra"])
    assert done.exit_code == 1
    assert 'did you mean "heavy/camera"' in done.output
