"""Saved states of a running server: the command line, files of the state folder, pieces over a socket, and recordings."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import uwclient
from click.testing import CliRunner
from nursery import python
from uwserver_bench.processes import serving

from uwserver.cli import main

SCENARIO = """
schema = 1
seed = 3

[server]
metrics_port = 0
{server}

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]

[adapters.tcp]
kind = "sockets"
port = 0
"""


def uwserver_run(*args: object) -> Any:
    command = ["run", *map(str, args), "--port", "0", "--mode", "freerun"]
    return CliRunner().invoke(main, command, catch_exceptions=False)


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "tank.toml"
    path.write_text(SCENARIO.format(server='state_folder = "states"'))
    return path


def test_a_run_goes_on_from_a_file(scenario: Path, tmp_path: Path) -> None:
    early, late, again = (tmp_path / f"{name}.uwstate" for name in ("early", "late", "again"))
    done = uwserver_run(scenario, "--until", 2, "--save-at", 1, early, "--save-at", 2, late)
    assert done.exit_code == 0, done.output
    record = tmp_path / "run.mcap"
    done = uwserver_run(scenario, "--until", 2, "--from", early, "--save-at", 2, again, "--record", record)
    assert done.exit_code == 0, done.output
    assert again.read_bytes() == late.read_bytes()
    replayed = CliRunner().invoke(main, ["replay", str(record)])
    assert replayed.exit_code == 0, replayed.output
    assert "hashes equal" in replayed.output


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (None, "No such file"),
        (b"", "must come with its size"),
        (b"x" * 1000, "check sum"),
        (bytes(2**24 + 1), "at most"),
    ],
)
def test_a_wrong_file_ends_the_start(scenario: Path, tmp_path: Path, content: bytes | None, text: str) -> None:
    path = tmp_path / "x.uwstate"
    if content is not None:
        path.write_bytes(content)
    done = uwserver_run(scenario, "--until", 1, "--from", path)
    assert done.exit_code == 1
    assert text in done.output


def test_a_time_that_is_over_cannot_be_saved(scenario: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.uwstate"
    uwserver_run(scenario, "--until", 2, "--save-at", 2, path)
    done = uwserver_run(scenario, "--until", 3, "--from", path, "--save-at", 1, tmp_path / "y.uwstate")
    assert done.exit_code == 1
    assert "begins later" in done.output


def test_a_time_that_is_never_reached_is_told(scenario: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.uwstate"
    done = uwserver_run(scenario, "--until", 1, "--save-at", 2, path)
    assert done.exit_code == 0
    assert not path.exists()
    assert "was not written: the run ended before 2 s" in done.output


@pytest.fixture
def client(scenario: Path) -> Iterator[uwclient.Client]:
    with serving(str(scenario), python=python()) as server, uwclient.connect(server.host, server.port) as client:
        yield client


def test_clients_save_and_load_files_by_name(client: Any, scenario: Path) -> None:
    client.call("world/pause")
    before = client.call("world/state_hash")["hash"]
    answer = client.call("world/save", name="calm")
    path = scenario.parent / "states/calm.uwstate"
    assert answer["bytes"] == path.stat().st_size
    client.call("world/step", n=50)
    assert client.call("world/load", name="calm")["tick"] == answer["tick"]
    assert client.call("world/state_hash")["hash"] == before
    assert list(path.parent.iterdir()) == [path]


def test_a_full_folder_is_told_and_nothing_is_written(client: Any, scenario: Path) -> None:
    folder = scenario.parent / "states"
    client.call("world/save", name="first")
    for k in range(63):
        (folder / f"{k}.uwstate").write_bytes(b"")
    with pytest.raises(uwclient.CallRefused, match="64 states"):
        client.call("world/save", name="second")
    assert not (folder / "second.uwstate").exists()
    assert client.call("world/save", name="first")["name"] == "first.uwstate"


@pytest.mark.parametrize("name", ["../calm", "/etc/passwd", "a/b", ".hidden", "", "x" * 200, "a\\b", "a\0b"])
def test_no_name_leads_out_of_the_folder(client: Any, scenario: Path, name: str) -> None:
    for service in ("world/save", "world/load"):
        if service == "world/save" and not name:
            continue  # pieces
        with pytest.raises(uwclient.CallRefused):
            client.call(service, name=name)
    assert not (scenario.parent / "states").exists()


def test_no_link_leads_out_of_the_folder(client: Any, scenario: Path) -> None:
    folder = scenario.parent / "states"
    folder.mkdir()
    (folder / "link.uwstate").symlink_to(scenario)
    os.mkfifo(folder / "pipe.uwstate")
    for name in ("link", "pipe", "missing"):
        with pytest.raises(uwclient.CallRefused, match="cannot be read"):
            client.call("world/load", name=name)


def test_pieces_over_a_socket(client: Any) -> None:
    client.call("world/pause")
    answer = client.call("world/save", length=3000)
    data = base64.b64decode(answer["data"])
    while len(data) < answer["bytes"]:
        piece = client.call("world/save", offset=len(data), length=3000, sha256=answer["sha256"])
        data += base64.b64decode(piece["data"])
    digest = client.call("world/state_hash")["hash"]
    client.call("world/step", n=20)
    for offset in range(0, len(data), 3000):
        piece = base64.b64encode(data[offset : offset + 3000]).decode()
        sha = hashlib.sha256(data).hexdigest()
        client.call("world/load", data=piece, offset=offset, bytes=len(data), sha256=sha)
    assert client.call("world/state_hash")["hash"] == digest
