"""`uwserver shot`: what it draws, and what it says of what it is asked for."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from chromium_rig import chromium_or_skip
from click.testing import CliRunner, Result

from uwserver.cli.browser.chromium import Page
from uwserver.cli.browser.shot import shot, wait_until_still

module = importlib.import_module("uwserver.cli.browser.shot")
PATIENCE_S = 300.0


def asked(*arguments: object) -> Result:
    return CliRunner().invoke(shot, [str(argument) for argument in arguments])


@pytest.fixture
def no_chromium(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))


@pytest.fixture
def any_chromium(tmp_path: Path) -> Path:
    """A program that is never started, for what is refused before."""
    file = tmp_path / "browser"
    file.write_text("#!/bin/sh\nexit 1\n")
    file.chmod(0o755)
    return file


def test_the_picture_is_of_what_was_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib import image

    chromium_or_skip()
    seen: list[object] = []

    def look(page: Page) -> None:
        wait_until_still(page)
        seen.extend(
            page.ask("[uw.drawing.view, uw.app.bodies[uw.app.chosen].name, uw.app.status.paused, uw.errors, uw.t]")
        )

    monkeypatch.setattr(module, "wait_until_still", look)
    file = tmp_path / "out.png"
    options = ("--view", "top", "--vehicle", "crate", "--size", "400x320", "--link", "quality=low&dock=off&view=board")
    done = asked("push_the_crate", file, "--at", 0.7, *options)
    assert done.exit_code == 0, done.output
    assert seen[:4] == ["top", "crate", True, []]
    assert seen[4] == pytest.approx(0.7, abs=1 / 200)
    assert f"wrote {file}" in done.output
    pixels = image.imread(file)[..., :3]
    assert pixels.shape == (320, 400, 3)
    assert len(np.unique((255 * pixels).astype(np.uint8).reshape(-1, 3), axis=0)) > 500


def running(mark: Path) -> list[str]:
    """Processes that have a path in their environment."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            is_ours = str(mark).encode() in (process / "environ").read_bytes()
            if is_ours and ") Z " not in (process / "stat").read_text():
                found.append((process / "cmdline").read_text())
        except OSError:  # it has just ended, or is of somebody else
            continue
    return found


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are counted in /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_what_it_began_ends_when_it_is_told_to(
    number: signal.Signals, tmp_path_factory: pytest.TempPathFactory
) -> None:
    chromium_or_skip()
    tmp_path = tmp_path_factory.mktemp("t")  # Chromium makes sockets there, whose names are short
    file = tmp_path / "o.png"
    command = [sys.executable, "-m", "uwserver", "shot", "bluerov2_pool", str(file), "--at", "1e6"]
    with subprocess.Popen(command, env={**os.environ, "TMPDIR": str(tmp_path)}, stderr=subprocess.PIPE) as process:
        try:
            pause = threading.Event()
            while not list(tmp_path.glob("uwshot-*/profile/Default")):  # Chromium has begun; so has the server
                assert process.poll() is None, process.stderr and process.stderr.read()
                pause.wait(0.1)
            assert len(running(tmp_path)) > 3
            process.send_signal(number)
            assert process.wait(PATIENCE_S) == {signal.SIGTERM: 143, signal.SIGINT: 1}[number]
            for _ in range(600):  # what Chromium began follows it
                if not running(tmp_path):
                    break
                pause.wait(0.1)
            assert running(tmp_path) == []
        finally:
            process.kill()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_chromium")
def test_without_chromium_it_says_in_a_line_what_to_install(tmp_path: Path) -> None:
    done = asked("bluerov2_pool", tmp_path / "out.png")
    assert done.exit_code == 1
    (line,) = done.output.splitlines()
    assert "apt install chromium" in line
    assert "--browser" in line


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("bluerov2_pol", "o.png"), 1, 'bluerov2_pool"?'),
        (("bluerov2_pool", "o.png", "--vehicle", "bluerov"), 1, 'no vehicle "bluerov" (did you mean "bluerov2"?)'),
        (("bluerov2_pool", "nowhere/o.png"), 1, "there is no folder nowhere"),
        (("bluerov2_pool", "o.gif"), 1, "must end in .png"),
        (("bluerov2_pool", "o.png", "--browser", "/no/such/program"), 1, 'no program "/no/such/program"'),
        (("bluerov2_pool", "o.png", "--view", "behind"), 2, "'orbit', 'follow', 'board', 'top'"),
        (("bluerov2_pool", "o.png", "--size", "1280"), 2, '"1280" is no size'),
        (("bluerov2_pool", "o.png", "--size", "1280x9"), 2, "within 320 and 4096"),
        (("bluerov2_pool", "o.png", "--at", "nan"), 2, "a number is needed"),
        (("bluerov2_pool", "o.png", "--at", "-1"), 2, "not in the range 0.0<=x<=1000000.0"),
    ],
)
def test_what_is_wrong_is_told_before_anything_starts(
    arguments: tuple[str, ...], status: int, words: str, any_chromium: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(any_chromium.parent)
    given = arguments if "--browser" in arguments else (*arguments, "--browser", str(any_chromium))
    done = asked(*given)
    assert (done.exit_code, words in done.output) == (status, True), done.output
    assert "Traceback" not in done.output
    assert not Path("o.png").exists()
