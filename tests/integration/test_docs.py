"""Every command and listing of README and tutorial runs as printed, only the port and an end are added; and what pages name is there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120
PAGES = ("README.md", "docs/tutorial.md", "clients/python/README.md")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.S | re.M)
MAKE = re.compile(r"^make (\w[\w-]*)", re.M)


def blocks(page: str, language: str) -> list[str]:
    return [code for kind, code in BLOCK.findall((ROOT / page).read_text()) if kind == language]


@contextmanager
def served(*scenario: str) -> Iterator[int]:
    """A server in four times real time; its port."""
    command = [sys.executable, "-m", "uwserver", "run", *scenario, "--port", "0", "--speed", "4"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert server.stdout is not None
        found = next(filter(None, (re.search(r"tcp: [\d.]+:(\d+)", line) for line in server.stdout)))
        yield int(found[1])
    finally:
        server.terminate()
        server.communicate(timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with served() as found:
        yield found


@pytest.fixture
def shell(tmp_path: Path, port: int):
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

    def run(command: str) -> str:
        command = command.replace(".venv/bin/", "")
        if "--port" not in command:
            command = re.sub(r"^uwclient ", f"uwclient --port {port} ", command)
        command = re.sub(r"localhost 7600", f"127.0.0.1 {port}", command)
        if command.startswith("uwserver run") and "--until" not in command:
            command += " --until 1 --mode freerun --port 0"
        done = subprocess.run(
            command, shell=True, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S,
            env=os.environ | {"PATH": path},
        )  # fmt: skip
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    return run


def python(code: str, port: int, cwd: Path) -> str:
    code = code.replace("uwclient.connect()", f"uwclient.connect(port={port})")
    code = code.replace("rov/", "bluerov2/") if "bluerov2" not in code and "uwclient" in code else code
    done = subprocess.run([sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, f"{code}\n{done.stderr}"
    return done.stdout


@pytest.mark.parametrize("page", PAGES)
def test_python_listings_run(page, port, tmp_path):
    listings = blocks(page, "python")
    assert listings
    for code in listings:
        assert python(code, port, tmp_path).strip()


def test_something_is_touched_as_the_how_to_says(tmp_path):
    page = "docs/how-to/touch-something.md"
    (listing,) = blocks(page, "python")
    commands = [line for code in blocks(page, "sh") for line in code.splitlines() if line.startswith("uwclient ")]
    with served("push_the_crate") as port:
        code = listing.replace("uwclient.connect()", f"uwclient.connect(port={port})")
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S
        )
        assert done.returncode == 0, done.stderr
        lines = done.stdout.splitlines()
        crate = [float(re.search(r"crate at ([\d.]+) m", line)[1]) for line in lines]
        assert len(crate) == 10
        assert crate[0] == 0.8
        assert crate[-1] > 1.5
        assert len(commands) == 2
        for command in commands:
            client = command.replace("uwclient ", f"uwclient --port {port} ", 1)
            done = subprocess.run(
                client, shell=True, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S,
                env=os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"},
            )  # fmt: skip
            assert done.returncode == 0, f"{client}\n{done.stdout}\n{done.stderr}"


def test_the_shell_commands_of_the_readme_run(shell):
    commands = [line for code in blocks("README.md", "sh") for line in code.splitlines()]
    run = [c for c in commands if not c.startswith("make")]
    assert len(run) >= 4
    for command in run:
        if " nc " in command and shutil.which("nc") is None:
            continue
        assert shell(command).strip() or " send " in command


def test_the_shell_commands_of_the_tutorial_run(shell, tmp_path):
    for code in blocks("docs/tutorial.md", "sh"):
        for command in code.splitlines():
            if not command.startswith("make"):
                shell(command)
    assert (tmp_path / "dive.mcap").exists()


def test_the_tutorial_s_own_scenario_takes_its_sensor(shell, tmp_path):
    shell("uwserver new tank")
    (extra,) = blocks("docs/tutorial.md", "toml")
    with (tmp_path / "tank.toml").open("a") as file:
        file.write("\n" + extra)
    assert "ok" in shell("uwserver check tank.toml")
    (tmp_path / "wrong.toml").write_text(
        (tmp_path / "tank.toml").read_text().replace("rate_hz = 10\n", "rate_hz = 100\n")
    )
    wrong = subprocess.run(
        [sys.executable, "-m", "uwserver", "check", "wrong.toml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert wrong.returncode == 1
    assert "80" in wrong.stdout + wrong.stderr
    assert "120" in wrong.stdout + wrong.stderr


def test_a_state_is_saved_and_loaded_as_the_how_to_says(shell, port, tmp_path):
    page = "docs/how-to/states.md"
    for code in blocks(page, "python"):
        assert "tick" in python(code, port, tmp_path)
    runs, files = blocks(page, "sh")
    for command in runs.splitlines():
        shell(command)
    assert (tmp_path / "later.uwstate").stat().st_size > 1000
    (tmp_path / "tank.toml").write_text(
        'schema = 1\n[server]\nstate_folder = "states"\nmetrics_port = 0\n[vehicles.rov]\nmodel = "bluerov2"\n'
        '[adapters.tcp]\nkind = "sockets"\n'
    )
    with served(str(tmp_path / "tank.toml")) as own:
        for command in files.splitlines():
            shell(command.replace("uwclient ", f"uwclient --port {own} ", 1))
    assert [path.name for path in (tmp_path / "states").iterdir()] == ["calm.uwstate"]


def test_every_make_target_that_is_named_exists():
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M))
    for page in (*PAGES, "CONTRIBUTING.md"):
        if (ROOT / page).exists():
            named = set(MAKE.findall((ROOT / page).read_text())) | set(
                re.findall(r"`make ([\w-]+)`", (ROOT / page).read_text())
            )
            assert named <= targets, page


def test_every_link_between_pages_leads_somewhere():
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", BLOCK.sub("", page.read_text())):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_every_file_that_is_named_is_there():
    """A page that leads through the source has to lead somewhere; a path begins at the top, so that it can be looked up."""
    top = {path.name for path in ROOT.iterdir() if path.is_dir()}
    for page in ("docs/explanation/architecture.md", "CONTRIBUTING.md"):
        named = re.findall(r"`([\w.-]+/[\w./-]*|[\w./-]+\.py)`", (ROOT / page).read_text())
        assert len(named) > 20, page
        lost = [path for path in named if path.split("/")[0] not in top or not (ROOT / path).exists()]
        assert not lost, f"{page}: {lost}"


def test_every_room_is_in_the_table_of_rooms():
    text = (ROOT / "docs/explanation/architecture.md").read_text()
    rooms = [path.parent for path in (ROOT / "uwserver").glob("*/__init__.py")]
    assert len(rooms) > 10
    assert not [room.name for room in rooms if f"`uwserver/{room.name}/`" not in text]
    inner = [
        path.parent for path in (ROOT / "uwserver").glob("*/*/__init__.py") if path.parts[-3] in ("scenario", "physics")
    ]
    assert not [room.name for room in inner if f"`{room.name}`" not in text]


def test_reference_pages_are_up_to_date():
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools/reference_docs.py"), "--check"],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr


def test_vehicle_pages_are_up_to_date():
    """Runs all manoeuvres of all shipped vehicles again."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools/vehicle_pages.py"), "--check"],
        capture_output=True,
        text=True,
        timeout=10 * PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
