"""Builder scripts of MORSE become scenarios; they are read, never run."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from uwserver.cli import main
from uwserver.scenario.authoring.morse_script import ACTUATORS, SENSORS, NoScript, scenario_from

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SCRIPT = """
from morse.builder import *
from math import pi
robot = ATRV("mana")
robot.translate(x=2.0, y=3.0, z=-5.0)
robot.rotate(z=pi / 2)
imu = IMU()
imu.translate(0.1, 0.05, 0.2)
imu.rotate(x=-pi, y=0.5, z=0.25)
imu.frequency(100)
robot.append(imu)
pose = Pose()
pose.add_stream('socket')
robot.append(pose)
motion = MotionVW()
robot.append(motion)
push = ForceTorque()
robot.append(push)
robot.add_default_interface('socket')
env = Environment('indoors-1/boxes')
"""


def convert(script: str) -> tuple[dict[str, object], list[str]]:
    text, remarks = scenario_from(script, "title", "bluerov2_heavy")
    return tomllib.loads(text), remarks


def test_a_robot_and_its_components() -> None:
    said, remarks = convert(SCRIPT)
    mana = said["vehicles"]["mana"]  # type: ignore[index]
    assert mana["position_ned_m"] == [3.0, 2.0, 5.0]
    assert mana["attitude_rpy_deg"] == [0.0, 0.0, 0.0]  # a quarter turn to the left of east is north
    imu = mana["sensors"]["imu"]
    assert imu["position_frd_m"] == [0.1, -0.05, -0.2]
    assert imu["rpy_deg"] == pytest.approx([-180.0, -28.64788976, -14.32394488])
    assert (imu["kind"], imu["rate_hz"]) == ("imu", 120)
    assert "autopilot" in mana
    assert mana["truth"] == {"rate_hz": 60}
    assert mana["override"]["actuators"]["push"] == {"kind": "force_torque"}
    assert [remark.partition(":")[0] for remark in remarks] == ["line 20"]


def test_what_is_not_understood_is_told_by_its_line() -> None:
    _, remarks = convert(
        SCRIPT
        + "cam = VideoCamera()\nrobot.append(cam)\nfor i in range(3):\n    x = ATRV()\nimu.alter('Noise')\nimu.frequency(f)\n"
    )
    told = "\n".join(remarks)
    for line, text in ((21, "VideoCamera"), (23, "for i in range(3)"), (25, "imu.alter"), (26, "imu.frequency(f)")):
        assert f"line {line}: " in told
        assert text in told


def test_a_robot_above_the_water_begins_at_its_surface() -> None:
    said, remarks = convert("robot = ATRV()\nrobot.translate(z=2.0)\n")
    assert said["vehicles"]["robot"]["position_ned_m"] == [0.0, 0.0, 0.0]  # type: ignore[index]
    assert "2 m above the water" in remarks[0]


@pytest.mark.parametrize(
    "script", ["", "x = 1", "def", "\0", "imu = IMU()", "(" * 5000, "-" * 100_000 + "1", "a" * (1 << 20)]
)
def test_no_script(script: str) -> None:
    with pytest.raises(NoScript):
        scenario_from(script, "t", "bluerov2_heavy")


def test_nothing_of_a_script_is_carried_out(tmp_path: Path) -> None:
    target = tmp_path / "made"
    convert(f"robot = ATRV(open({str(target)!r}, 'w').write('x'))\n__import__('os').mkdir({str(tmp_path / 'd')!r})\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", ["1e999", "1/0", "2**9", "'x'", "x()", "True"])
def test_numbers_that_are_none_are_told(number: str) -> None:
    said, remarks = convert(f"robot = ATRV()\nrobot.translate({number})\n")
    assert said["vehicles"]["robot"]["position_ned_m"] == [0.0, 0.0, 0.0]  # type: ignore[index]
    assert remarks


def test_the_scenario_of_every_known_class_is_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `uwserver new` writes it and `uwserver check` reads it."""
    monkeypatch.chdir(tmp_path)
    lines = ["robot = ATRV()"]
    for n, cls in enumerate([*SENSORS, *ACTUATORS, "Pose", "Battery", "Waypoint"]):
        lines += [f"part{n} = {cls}()", f"part{n}.frequency({n + 1})", f"robot.append(part{n})"]
    Path("builder.py").write_text("\n".join(lines))
    made = CliRunner().invoke(main, ["new", "sea", "--from-morse", "builder.py"])
    assert made.exit_code == 0, made.output
    text = Path("sea.toml").read_text()
    Path("sea.toml").write_text(text[: text.index("[adapters.morse]")])
    checked = CliRunner().invoke(main, ["check", "sea.toml"])
    assert checked.exit_code == 0, checked.output
