"""The C program and the shell script against the fake server; tests/integration/test_pages.py follows the pages on a real one."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from uwclient_fake_server import FakeServer

VALUE = '{"u":[0.3,0.3,-0.3,-0.3,0,0,0,0]}'


@pytest.fixture(scope="module")
def uw_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: cc is not installed")
    folder = Path(__file__).parents[3] / "clients" / "c"
    (line,) = re.findall(r"^cc .*$", (folder / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    program = tmp_path_factory.mktemp("c") / "uw_drive"
    words = [str(program) if word == "uw_drive" else word for word in line.split()]
    subprocess.run([words[0], "-Werror", *words[1:]], cwd=folder, check=True, timeout=120)
    return program


def run(
    *command: str | Path, env: dict[str, str] | None = None, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, timeout=120, env=env, cwd=cwd, encoding="utf-8"
    )


@pytest.mark.parametrize("piece", [0, 1, 5])
def test_c_example(server: FakeServer, uw_drive: Path, piece: int) -> None:
    server.piece = piece
    server.samples = 9
    done = run(uw_drive, "127.0.0.1", str(server.port), "rov/imu", "rov/thrusters", VALUE)
    assert done.returncode == 0, done.stderr
    samples = [json.loads(line)["params"] for line in done.stdout.splitlines()]
    assert [sample["seq"] for sample in samples] == [0, 1, 2, 4, 5]
    assert server.told("subscribe") == [{"pattern": "rov/imu"}]


def test_c_example_sends_the_command_and_the_token(uw_drive: Path) -> None:
    with FakeServer(token="secret") as server:
        server.samples = 3
        command = (uw_drive, "127.0.0.1", str(server.port), "rov/*", "rov/thrusters", VALUE)
        denied = run(*command, env={"UWSERVER_TOKEN": ""})
        assert denied.returncode == 1
        assert run(*command, env={"UWSERVER_TOKEN": "secret"}).returncode == 0
        assert server.told("hello") == [{"version": 1, "name": "uw_drive", "token": "secret"}]


def test_c_example_tells_what_is_wrong(server: FakeServer, uw_drive: Path, unused_port: int) -> None:
    assert run(uw_drive).returncode == 2
    absent = run(uw_drive, "127.0.0.1", str(unused_port), "rov/imu", "rov/thrusters", VALUE)
    assert (absent.returncode, "`uwserver run`" in absent.stderr) == (1, True)
    server.samples = 0
    refused = run(uw_drive, "127.0.0.1", str(server.port), "rov/imu", "rov/thrusters", '{"u":[2]}')
    assert (refused.returncode, "out_of_range" in refused.stderr) == (1, True)


@pytest.fixture
def drive(clients: Path) -> list[str]:
    if shutil.which("nc") is None:
        pytest.skip("no nc: neither netcat-openbsd nor netcat-traditional is installed")
    return ["sh", str(clients / "nc" / "drive.sh"), "127.0.0.1"]


def test_nc_example(server: FakeServer, drive: list[str]) -> None:
    done = run(*drive, str(server.port), "rov/imu", "rov/thrusters")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(lines[0]["result"]["ports"]) == 3
    assert lines[1]["result"]["tick"] == 100
    assert [line["params"]["seq"] for line in lines if line.get("method") == "sample"] == [0, 1, 2]
    assert server.told("command") == [{"port": "rov/thrusters", "value": json.loads(VALUE)}]


def test_nc_example_ends_without_samples_and_on_a_refusal(server: FakeServer, drive: list[str]) -> None:
    server.samples = 0
    silent = run(*drive, str(server.port), "rov/imu", "rov/thrusters")
    assert (silent.returncode, "only 0 samples" in silent.stderr) == (1, True)
    refused = run(*drive, str(server.port), "rov/imu", "rov/thrusters", '{"u":[2]}')
    assert (refused.returncode, "refused" in refused.stderr) == (1, True)


def test_nc_example_without_nc(clients: Path, tmp_path: Path) -> None:
    done = run("/bin/sh", clients / "nc" / "drive.sh", env={"PATH": str(tmp_path)})
    assert done.returncode == 127
    assert "netcat" in done.stderr
