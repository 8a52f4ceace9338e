"""Each example, run as its first lines say: a paused server of its scenario, the program, and how well it did what it is for.

`make test` runs one of them, and of all others sees that the scenario loads and has what the program asks for.
"""

from __future__ import annotations

import json
import math
import os
import re
import runpy
import shutil
import socket
import subprocess
import sys
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
PATIENCE_S = 300
sys.path.insert(0, str(ROOT / "tests"))

from server_process import serving  # noqa: E402

import uwserver  # noqa: E402
from uwserver.logfiles import open_log  # noqa: E402
from uwserver.scenario.files.documents import shipped  # noqa: E402


def run(scenario: str, program: str, *arguments: str, options: tuple[str, ...] = ()) -> list[float]:
    """The numbers of the last line that the program prints; `options` are those of the server."""
    with serving(EXAMPLES / scenario, "--paused", *options) as ((_, port), _):
        command = [sys.executable, str(EXAMPLES / program), "--port", str(port), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", done.stdout.splitlines()[-1])]


PROGRAMS = sorted(path.stem for path in EXAMPLES.glob("*.py") if path.with_suffix(".toml").exists())


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_scenario_has_what_the_program_asks_for(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    runpy.run_path(str(EXAMPLES / f"{name}.py"))
    world = uwserver.load(EXAMPLES / f"{name}.toml")
    said = world.step(24)
    assert {sample.port.split("/")[0] for sample in said} >= set(world.vehicles)
    text = (EXAMPLES / f"{name}.py").read_text()
    heard = re.findall(r'"([\w/]+)"', "".join(re.findall(r"heard = \((.*?)\)", text)))
    asked = {*re.findall(r'"(rov/[\w/]+)"', text), *(f"rov/{port}" for port in heard)}
    assert not asked - set(world.ports)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    pytest.importorskip("matplotlib")
    return tmp_path / "picture.png"


def test_depth_and_heading_follow_their_set_points(picture: Path) -> None:
    depth, heading = run("depth_heading.toml", "depth_heading.py", "--out", str(picture))
    assert 0.0 < depth < 0.1
    assert 0.0 < heading < 8.0
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_all_waypoints_are_visited_along_their_legs(picture: Path) -> None:
    seconds, most, half, drift = run("waypoints.toml", "waypoints.py", "--out", str(picture))
    assert 60.0 < seconds < 130.0
    assert half < 0.22
    assert most < 0.65
    assert 0.0 < drift < 0.5
    assert picture.exists()


@pytest.mark.slow
def test_the_pipe_is_followed_to_its_end(picture: Path) -> None:
    _, most, half, end = run("pipe.toml", "pipe.py", "--out", str(picture))
    assert most < 0.6
    assert half < 0.12
    assert 29.0 < end < 33.0
    assert picture.exists()


@pytest.mark.slow
def test_a_pipe_is_followed_in_the_pictures_of_a_sonar(picture: Path, tmp_path: Path) -> None:
    log = tmp_path / "pipe.mcap"
    _, along, most, half = run("pipe_picture.toml", "pipe_picture.py", "--out", str(picture), options=("--record", str(log)))  # fmt: skip
    assert along > 43.0
    assert most < 0.4
    assert half < 0.12
    assert picture.exists()
    with closing(open_log(log)) as recorded:
        assert sum(value["valid"] for _, _, value in recorded.read({"rov/sonar"})) > 400


@pytest.mark.parametrize(("east", "heading_deg"), [(0.0, 0.0), (0.8, -20.0), (-0.6, 15.0), (-9.0, 0.0)])
def test_the_pipe_is_found_in_one_picture(
    east: float, heading_deg: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it is from there, and none over sand alone."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    found = runpy.run_path(str(EXAMPLES / "pipe_picture.py"))
    text, start = (EXAMPLES / "pipe_picture.toml").read_text(), "position_ned_m = [-3.0, 0.8, 9.5]"
    assert start in text
    there = f"position_ned_m = [0.5, {east}, 9.8]\nattitude_rpy_deg = [0.0, 0.0, {heading_deg}]"
    (tmp_path / "one.toml").write_text(text.replace(start, there))
    world = uwserver.load(tmp_path / "one.toml")
    heard = world.record("rov/sonar")
    world.step(120)
    sonar = heard["rov/sonar"]
    height = 12.0 - 9.8 - found["BELOW_M"]
    points = found["pipe_in"](sonar.image[0], sonar.azimuth[0], sonar.range[0], height, found["TILT_RAD"])
    piece = found["nearest_piece"](points)
    if abs(east) > 5.0:
        assert piece is None
        return
    heading = math.radians(heading_deg)
    across = east + (piece.x + found["AHEAD_M"]) * math.sin(heading) + piece.y * math.cos(heading)
    assert across == pytest.approx(0.0, abs=0.12)
    assert piece.course == pytest.approx(-heading, abs=0.05)


@pytest.mark.slow
def test_it_docks_without_a_bump(picture: Path) -> None:
    _, off, bumps = run("dock.toml", "dock.py", "--out", str(picture))
    assert 0.0 < off < 0.2
    assert bumps == 0
    assert picture.exists()


@pytest.mark.slow
def test_a_survey_is_shared_by_modem(picture: Path) -> None:
    cells, known, off = run("share_survey.toml", "share_survey.py", "--out", str(picture))
    assert cells == known == 42
    assert off < 0.1
    assert picture.exists()


@pytest.mark.slow
def test_the_page_on_modems_says_what_happens(tmp_path: Path) -> None:
    """Of docs/how-to/modem.md: its listing, and its scenario as it stands there."""
    page = (ROOT / "docs/how-to/modem.md").read_text()
    listing, asking = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    done = subprocess.run([sys.executable, "-c", listing], cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert re.fullmatch(r"0\.20\d s east/modem/received: data b'hello' range None", first)
    # By the sound speed where it is; the first sound went through warmer water.
    assert float(second.rpartition(" ")[2]) == pytest.approx(300.0, abs=4.0)
    with serving(EXAMPLES / "share_survey.toml") as ((host, port), _):
        there = asking.replace("uwclient.connect()", f"uwclient.connect({host!r}, {port})")
        done = subprocess.run([sys.executable, "-c", there], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    away, travel, snr, parting = done.stdout.split()
    assert float(away) == pytest.approx(300.0, abs=8.0)
    assert 2.0 * float(away) / float(travel) == pytest.approx(1500.0, abs=50.0)
    assert abs(float(parting)) < 1.5
    assert float(snr) > 10.0
    (scenario,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "page.toml").write_text(scenario)
    world = uwserver.load(tmp_path / "page.toml")
    world.command("auv/modem/send", destination=2, acknowledge=1)
    events = [s.value[0] for s in world.step(1200) if s.port == "auv/modem/received"]
    assert events == ["delivered"]


@pytest.mark.slow
def test_the_swarm_forms_its_wedge(picture: Path, tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    text, port = (EXAMPLES / "swarm.toml").read_text(), free_port()
    assert "7447" in text
    (tmp_path / "swarm.toml").write_text(text.replace("7447", str(port)))
    command = [sys.executable, "-m", "uwserver", "run", str(tmp_path / "swarm.toml"), "--paused"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        try:
            assert server.stdout is not None
            assert any(f"tcp/127.0.0.1:{port}" in line for line in server.stdout)
            program = [sys.executable, str(EXAMPLES / "swarm.py"), "--connect", f"tcp/127.0.0.1:{port}"]
            done = subprocess.run([*program, "--out", str(picture)], capture_output=True, text=True, timeout=PATIENCE_S)
        finally:
            server.terminate()
            server.communicate(timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    (off,) = re.findall(r"more than ([\d.]+) m", done.stdout)
    assert float(off) < 0.3
    assert picture.exists()


@pytest.mark.slow
def test_a_mission_is_flown(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    text, port = shipped()["bluerov2_qgc"].read_text(), free_port(socket.SOCK_DGRAM)
    assert "14550" in text
    (tmp_path / "qgc.toml").write_text(text.replace("14550", str(port)))
    with serving(tmp_path / "qgc.toml", "--speed", "4"):
        command = [sys.executable, str(EXAMPLES / "mission.py"), "--link", f"udpin:127.0.0.1:{port}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("waypoint") == 3
    (off,) = re.findall(r"at most ([\d.]+) m off", done.stdout)
    assert float(off) < 1.0


@pytest.mark.slow
def test_the_notebook_finds_the_drag_of_the_vehicle_file(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    cells = json.loads((EXAMPLES / "drag.ipynb").read_text())["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    linear, quadratic = map(float, re.findall(r"linear ([\d.]+) N s/m, quadratic ([\d.]+)", done.stdout)[0])
    assert linear == pytest.approx(4.03, rel=0.25)
    assert quadratic == pytest.approx(34.6, rel=0.1)
    assert (tmp_path / "drag.png").exists()


def test_a_survey_of_moos_ivp(tmp_path: Path, picture: Path) -> None:
    """Helm and autopilot are real; each program of the Antler block is started, with the ports changed."""
    if not os.environ.get("UWSERVER_MOOS_BIN"):
        pytest.skip("UWSERVER_MOOS_BIN is not set: a folder with pHelmIvP, pMarinePIDV22, uPokeDB")
    programs, port = Path(os.environ["UWSERVER_MOOS_BIN"]), free_port()
    for name in ("server.toml", "survey.moos", "survey.bhv"):
        (tmp_path / name).write_text((EXAMPLES / "moos" / name).read_text().replace("9000", str(port)))
    started = re.findall(r"^\s*Run = (\w+)", (tmp_path / "survey.moos").read_text(), re.MULTILINE)
    assert len(started) == 2
    with ExitStack() as stack:
        (_, tcp), _ = stack.enter_context(serving(tmp_path / "server.toml"))
        for program in started:
            process = subprocess.Popen(
                [program, "survey.moos"], executable=programs / program, cwd=tmp_path,
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            stack.callback(process.wait)
            stack.callback(process.kill)
        poke = [programs / "uPokeDB", "survey.moos", "DEPLOY=true", "MOOS_MANUAL_OVERRIDE=false"]
        command = [sys.executable, str(EXAMPLES / "moos/track.py"), "--port", str(tcp), "--out", str(picture)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as tracked:
            for _ in range(20):  # the helm writes DEPLOY=false as it starts
                subprocess.run(poke, cwd=tmp_path, capture_output=True, timeout=PATIENCE_S, stdin=subprocess.DEVNULL)
                with suppress(subprocess.TimeoutExpired):
                    tracked.wait(3.0)
                    break
            output, fault = tracked.communicate(timeout=PATIENCE_S)
    assert tracked.returncode == 0, fault
    _, across, above = (float(number) for number in re.findall(r"\d+(?:\.\d+)?", output.splitlines()[-1]))
    assert across < 2.0
    assert above < 1.0
    assert picture.exists()


def holds_a_depth(*command: str) -> None:
    """A compiled client, against the scenario that its first lines name."""
    with serving("bluerov2_pool", "--paused") as ((host, port), _):
        words = [word.format(host=host, port=port) for word in command]
        done = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S)
        wrong = subprocess.run([*words[:-1], "x"][:1], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"depth (1\.9[5-9]|2\.0[0-5]) m\n", done.stdout)
    assert wrong.returncode == 2
    assert "usage" in wrong.stderr


@pytest.mark.slow
def test_cpp(tmp_path: Path) -> None:
    if shutil.which("c++") is None or not Path("/usr/include/asio.hpp").exists():
        pytest.skip("no C++ compiler, or no asio (Debian: libasio-dev)")
    source = EXAMPLES / "cpp/depth_hold.cpp"
    (line,) = re.findall(r"^//   (c\+\+ .*)$", source.read_text(), re.M)
    words = [str(source) if word == source.name else word for word in line.split()]
    subprocess.run([*words, "-Werror"], cwd=tmp_path, check=True, timeout=PATIENCE_S)
    holds_a_depth(str(tmp_path / "depth_hold"), "{host}", "{port}", "2.0")


@pytest.mark.slow
def test_rust(tmp_path: Path) -> None:
    if shutil.which("rustc") is None:
        pytest.skip("no rustc")
    source = EXAMPLES / "rust/depth_hold.rs"
    subprocess.run(["rustc", "-O", "-D", "warnings", str(source)], cwd=tmp_path, check=True, timeout=PATIENCE_S)
    holds_a_depth(str(tmp_path / "depth_hold"), "{host}:{port}", "2.0")


@pytest.mark.slow
def test_octave() -> None:
    if shutil.which("octave-cli") is None:
        pytest.skip("Octave is not installed: depth_hold.m is not run")
    with serving("bluerov2_pool", "--paused") as ((host, port), _):
        call = f'depth_hold("{host}", {port}, 2.0);'
        command = ["octave-cli", "--path", str(EXAMPLES / "matlab"), "--eval", call]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert re.search(r"depth (1\.9[5-9]|2\.0[0-5]) m", done.stdout), done.stderr


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
