"""A vehicle docks by AprilTags that its camera renders and a real detector finds: from many places, in currents, and blind on the way."""

from __future__ import annotations

import math
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
PATIENCE_S = 1200
sys.path.insert(0, str(ROOT / "tests"))

from server_process import serving  # noqa: E402

import uwserver  # noqa: E402

pytest.importorskip("PIL")
START = "position_ned_m = [1.0, 1.5, 7.2]\nattitude_rpy_deg = [0.0, 0.0, -150.0]"
CURRENT = "velocity_ned_mps = [-0.05, 0.10, 0.0]"
DOCK, COURSE_DEG = (6.0, 2.0, 8.0), 30.0
BLIND = '\n[faults.blind]\nkind = "sensor_silent"\ntarget = "rov/camera"\nat_s = 20\nuntil_s = 45\n'
Start = tuple[float, float, float, float]
"""In the dock's frame: ahead, to starboard, down (m), heading (deg)."""


@pytest.fixture
def tags(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return runpy.run_path(str(EXAMPLES / "tags.py"))


@pytest.fixture
def detector() -> None:
    pytest.importorskip("pupil_apriltags", reason="pip install pupil-apriltags")
    pytest.importorskip("embreex")


def scenario(folder: Path, start: Start, current: str = CURRENT, more: str = "") -> Path:
    """That of the example with another start, another current, and more at its end."""
    text = (EXAMPLES / "dock_tags.toml").read_text()
    assert START in text
    assert CURRENT in text
    x, y, z, yaw = start
    c, s = math.cos(math.radians(COURSE_DEG)), math.sin(math.radians(COURSE_DEG))
    place = [DOCK[0] + c * x - s * y, DOCK[1] + s * x + c * y, DOCK[2] + z]
    there = f"position_ned_m = {place}\nattitude_rpy_deg = [0.0, 0.0, {COURSE_DEG + yaw}]"
    (folder / "dock_tags.toml").write_text(text.replace(START, there).replace(CURRENT, current) + more)
    shutil.copy(EXAMPLES / "dock_tags.glb", folder)
    return folder / "dock_tags.toml"


def docks(file: Path, *arguments: str) -> tuple[float, float]:
    """Runs the program until it has docked, well: seconds and tries."""
    with serving(file, "--paused") as ((_, port), _):
        command = [sys.executable, str(EXAMPLES / "dock_tags.py"), "--port", str(port), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    words = re.findall(r"\d+(?:\.\d+)?", done.stdout.splitlines()[-1])
    seconds, pictures, tries, off, turned, bumps = map(float, words)
    assert 0.0 < off < 0.05, done.stdout
    assert turned < 3.0, done.stdout
    assert bumps == 0, done.stdout
    assert pictures > 10
    return seconds, tries


@pytest.mark.parametrize(
    ("start", "off", "turned_deg"),
    [
        pytest.param((-5.5, 0.0, 0.0, 0.0), 0.15, 2.5, marks=pytest.mark.slow),
        ((-4.0, -2.0, -0.4, 20.0), 0.06, 0.8),
        ((-2.5, 0.1, 0.0, -3.0), 0.02, 0.4),
        ((0.0, 0.0, 0.0, 0.0), 0.01, 0.4),
        ((-4.0, 0.0, 0.0, 180.0), 0.0, 0.0),
    ],
)
def test_the_dock_is_found_in_one_picture(
    start: Start, off: float, turned_deg: float, tmp_path: Path, tags: dict[str, Any], detector: None
) -> None:
    """Where it is from there, as exactly as the pose claims; and nowhere with the back to it."""
    world = uwserver.load(scenario(tmp_path, start))
    world.command("rov/lights", levels=[0.5, 0.5])
    heard = world.record("rov/camera", "rov/truth/pose")
    world.step(240)
    camera, truth = heard["rov/camera"], heard["rov/truth/pose"]
    middle, focal = (319.5, 239.5), 320.0 / math.tan(math.radians(40.0))
    seen = tags["Finder"](tags["Lens"](focal, focal, *middle)).find(np.asarray(camera.image[-1]))
    if not off:
        assert seen is None
        return
    nearest = int(np.argmin(np.abs(truth.t - camera.t[-1])))
    q, p = truth.q_NB[nearest], truth.p_NB[nearest]
    away = np.array(rotated((q[0], *-q[1:]), np.array(DOCK) - p)) - (0.2, 0.0, -0.02)
    right, down, ahead = seen.p_C
    assert math.dist((ahead, right, down), away) < off
    assert seen.sigma_p < off
    heading = math.degrees(math.atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] ** 2 + q[3] ** 2)))
    turned = math.degrees(math.atan2(seen.R_CD[0, 0], seen.R_CD[2, 0]))
    assert turned == pytest.approx(COURSE_DEG - heading, abs=turned_deg)
    assert math.degrees(seen.sigma_course) < turned_deg


def rotated(q: tuple[float, ...], v: np.ndarray) -> np.ndarray:
    w, u = q[0], np.array(q[1:])
    return v + 2.0 * np.cross(u, np.cross(u, v) + w * v)


@pytest.mark.slow
def test_it_docks_from_before_the_dock(tmp_path: Path, detector: None) -> None:
    """What it sees of the dock is tried picture by picture above."""
    pytest.importorskip("matplotlib")
    _, tries = docks(scenario(tmp_path, (-2.7, 0.15, -0.1, 5.0)), "--out", str(tmp_path / "picture.png"))
    assert tries == 1
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "current"),
    [
        pytest.param((-3.5, 3.0, -1.0, -20.0), CURRENT, id="above, from the right"),
        pytest.param((-2.5, -3.0, 0.8, 160.0), CURRENT, id="below, from the left"),
        pytest.param((-4.5, 1.0, -0.5, 30.0), "velocity_ned_mps = [0.1, -0.17, 0.0]", id="0.2 m/s across"),
    ],
)
def test_it_docks_from_anywhere_before_the_dock(start: Start, current: str, tmp_path: Path, detector: None) -> None:
    docks(scenario(tmp_path, start, current))


@pytest.mark.slow
def test_it_looks_for_a_dock_that_it_cannot_see_from_where_it_begins(tmp_path: Path, detector: None) -> None:
    seconds, _ = docks(scenario(tmp_path, (-7.4, 0.6, 0.0, 0.0)))
    assert seconds > 24.0 + 2.0 + 24.0, "a turn, and a leg of the square"


@pytest.mark.slow
def test_blind_on_its_way_it_leaves_the_dock_and_enters_again(tmp_path: Path, detector: None) -> None:
    """As the tutorial has it."""
    page = (ROOT / "docs/tutorial/sonar-and-camera.md").read_text()
    (fault,) = re.findall(r"```toml\n(\[faults\.blind\]\n.*?)```", page, re.DOTALL)
    text = (EXAMPLES / "dock_tags.toml").read_text()
    (tmp_path / "dock_tags.toml").write_text(f"{text}\n{fault}")
    shutil.copy(EXAMPLES / "dock_tags.glb", tmp_path)
    _, tries = docks(tmp_path / "dock_tags.toml")
    assert tries == 2


@pytest.mark.slow
def test_blind_for_long_it_searches_anew(tmp_path: Path, detector: None) -> None:
    seconds, tries = docks(scenario(tmp_path, (-3.0, 0.3, -0.2, 8.0), more=BLIND))
    assert tries == 2
    assert seconds > 55.0


def test_the_file_of_the_dock_is_what_the_program_makes(tmp_path: Path, tags: dict[str, Any]) -> None:
    from uwserver.sensors.optical.camera.gltf import read_glb

    tags["make"](tmp_path / "dock.glb")
    made, shipped = (read_glb(path.read_bytes()) for path in (tmp_path / "dock.glb", EXAMPLES / "dock_tags.glb"))
    assert (made.faces == shipped.faces).all()
    assert len(made.pictures) == len(tags["TAGS"])
    assert all((a == b).all() for a, b in zip(made.pictures, shipped.pictures, strict=True))
