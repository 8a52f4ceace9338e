"""Recordings that a client of a running server begins: over a socket, of a server that is killed, and played again."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from nursery import python
from server_process import PATIENCE_S, Peer

from uwserver.recording.replay import replay

SCENARIO = """
schema = 1
seed = 4
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 2.0]
[adapters.tcp]
kind = "sockets"
port = 0
[server]
metrics = false
web = false
"""


@contextmanager
def served(folder: Path, *command: str, program: str = "") -> Iterator[tuple[Peer, subprocess.Popen[str]]]:
    """A client of a server that is started in a folder."""
    line = [program or python(), "-m", "uwserver", *command, "--port", "0"]
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with subprocess.Popen(line, cwd=folder, **pipes) as process:
        try:
            assert process.stdout is not None
            found = next((f for said in process.stdout if (f := re.search(r"tcp: ([\d.]+):(\d+)", said))), None)
            assert found is not None, "the server ended"
            with closing(Peer((found[1], int(found[2])))) as peer:
                assert "error" not in peer.ask("hello", version=1, name="test")
                yield peer, process
        finally:
            process.kill()


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    (tmp_path / "dive.toml").write_text(SCENARIO)
    return tmp_path


def recorder(peer: Peer) -> dict[str, Any]:
    """What the server's status says of it."""
    found: dict[str, Any] = peer.call("world/status")["result"]["value"]["recorder"]
    return found


def has_grown(peer: Peer, size: int) -> None:
    """Wait until so many bytes are written."""
    end = time.monotonic() + PATIENCE_S
    while recorder(peer)["bytes"] <= size:
        assert time.monotonic() < end, "nothing is written"
        time.sleep(0.05)


def test_a_killed_server_leaves_a_recording_that_replays_to_its_last_chunk(dive: Path) -> None:
    with served(dive, "run", "dive.toml", program=sys.executable) as (peer, process):
        began = peer.call("recording/start", name="run")["result"]["value"]
        assert began == {"name": "run.mcap", "path": str(dive / "recordings/run.mcap"), "t_ns": began["t_ns"]}
        has_grown(peer, recorder(peer)["bytes"])
        peer.ask("command", port="rov/thrusters", value={"u": [0.3] * 8})
        for _ in range(3):  # a second has its hash
            has_grown(peer, recorder(peer)["bytes"])
        process.kill()
        process.wait(PATIENCE_S)
    found = replay(dive / "recordings/run.mcap")
    assert (found.truncated, found.difference, found.requests) == (True, None, 1)
    assert found.hashes >= 1


def test_it_is_played_from_where_it_begins(dive: Path) -> None:
    with served(dive, "run", "dive.toml", "--mode", "freerun", "--paused") as (peer, _):  # else 5 s may be past already
        assert peer.call("world/run_until", t_s=5.0)["result"]["t_ns"] >= 5e9
        began = peer.call("recording/start", name="run")["result"]["value"]
        end = began["t_ns"] / 1e9 + 3.0
        peer.call("world/run_until", t_s=end)
        ended = peer.call("recording/stop")["result"]["value"]
        assert (ended["recording"], ended["error"]) == (False, "")
        assert ended["since_ns"] == began["t_ns"] >= 5_000_000_000
    with served(dive, "play", "recordings/run.mcap", "--paused") as (peer, _):
        state = peer.call("playback/state")["result"]["value"]
        assert state["from_s"] == pytest.approx(began["t_ns"] / 1e9, abs=0.2)
        assert state["to_s"] >= end - 0.01, "what is measured is under way for 2 ms"
        refused = peer.call("recording/start")["error"]["data"]
        assert refused["code"] == "denied"
