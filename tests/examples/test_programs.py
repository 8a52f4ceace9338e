"""Each example, run as its first lines say: a paused server of its scenario, the program, and how well it did what it is for."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
PATIENCE_S = 300
sys.path.insert(0, str(ROOT / "tests"))

from server_process import serving  # noqa: E402


def run(scenario: str, program: str, *arguments: str) -> list[float]:
    """The numbers of the last line that the program prints."""
    with serving(EXAMPLES / scenario, "--paused") as ((_, port), _):
        command = [sys.executable, str(EXAMPLES / program), "--port", str(port), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", done.stdout.splitlines()[-1])]


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    pytest.importorskip("matplotlib")
    return tmp_path / "picture.png"


def test_depth_and_heading_follow_their_set_points(picture: Path) -> None:
    depth, heading = run("depth_heading.toml", "depth_heading.py", "--out", str(picture))
    assert 0.0 < depth < 0.1
    assert 0.0 < heading < 8.0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_all_waypoints_are_visited_along_their_legs(picture: Path) -> None:
    seconds, most, half, drift = run("waypoints.toml", "waypoints.py", "--out", str(picture))
    assert 60.0 < seconds < 130.0
    assert half < 0.3
    assert most < 0.9
    assert 0.0 < drift < 0.5
    assert picture.exists()


def test_the_pipe_is_followed_to_its_end(picture: Path) -> None:
    _, most, half, end = run("pipe.toml", "pipe.py", "--out", str(picture))
    assert most < 0.6
    assert half < 0.12
    assert 29.0 < end < 33.0
    assert picture.exists()


def test_it_docks_without_a_bump(picture: Path) -> None:
    _, off, bumps = run("dock.toml", "dock.py", "--out", str(picture))
    assert 0.0 < off < 0.2
    assert bumps == 0
    assert picture.exists()
