"""The built-in autopilot through a real server: the listing of the how-to, and a goto that reports, is cancelled, and is replayed."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import uwclient
from nursery import python

from uwserver.recording.replay import replay

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120


@contextmanager
def served(*options: str) -> Iterator[int]:
    """A server of the scenario in sixteen times real time; its port."""
    command = [python(), "-m", "uwserver", "run", "rov_autopilot", "--port", "0", "--speed", "16", *options]
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
    """Of the server of those who follow the page."""
    with served() as found:
        ready(found)
        yield found


def ready(port: int) -> None:
    """Its sensors have spoken."""
    with uwclient.connect(port=port) as sim:
        sim.wait_until(3.0, timeout=PATIENCE_S)


def listings(port: int) -> list[str]:
    """The page's Python, for a server on this port."""
    page = (ROOT / "docs/how-to/autopilot.md").read_text()
    return [code.replace("7600", str(port)) for code in re.findall(r"^```python\n(.*?)^```", page, re.S | re.M)]


def test_ten_lines_of_socket_code_command_its_depth(port):
    code, _ = listings(port)
    assert len([line for line in code.splitlines() if line]) == 10
    done = subprocess.run([python(), "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert "error" not in done.stdout
    with uwclient.connect(port=port) as sim:
        sim.subscribe("rov/autopilot/state")
        sim.wait_until(sim.status()["t_s"] + 30.0, timeout=PATIENCE_S)
        state = sim.latest("rov/autopilot/state")
        assert state is not None
        assert state.value["depth"] == pytest.approx(5.0, abs=0.1)
        assert state.value["mode"] == "depth_hold"


def test_the_page_tries_a_thruster(port):
    first, then = listings(port)
    connection = first.partition("    print(")[0]  # the page goes on with that of its first listing
    code = connection + textwrap.indent(re.sub("^ask", 'assert "error" not in ask', then, flags=re.M), "    ")
    done = subprocess.run([python(), "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr


class Peer:
    """A client that speaks JSON lines by hand, so that it sees progress as it comes."""

    def __init__(self, port: int) -> None:
        self._port = port

    async def __aenter__(self) -> Peer:
        self._reader, self._writer = await asyncio.open_connection("127.0.0.1", self._port)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._writer.close()
        await self._writer.wait_closed()

    def say(self, number: int, method: str, **params: object) -> None:
        text = json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params})
        self._writer.write(text.encode() + b"\n")

    async def hear(self, wanted) -> dict:
        while True:
            message = json.loads(await asyncio.wait_for(self._reader.readline(), PATIENCE_S))
            if wanted(message):
                return message


async def talk(port: int) -> None:
    async with Peer(port) as peer:
        peer.say(1, "call", service="rov/autopilot/arm", args={})
        assert "result" in await peer.hear(lambda m: m.get("id") == 1)
        peer.say(2, "call", service="rov/autopilot/goto", args={"position_ned_m": [3, 0, 3], "radius_m": 0.5})
        assert await peer.hear(lambda m: m.get("method") == "progress")
        done = await peer.hear(lambda m: m.get("id") == 2)
        assert "error" not in done, done
        peer.say(3, "call", service="rov/autopilot/goto", args={"position_ned_m": [90, 0, 3]})
        await peer.hear(lambda m: m.get("method") == "progress")
        peer.say(4, "cancel", id=3)
        over = await peer.hear(lambda m: m.get("id") == 3)
        assert "cancelled" in json.dumps(over)
        peer.say(5, "command", port="rov/thrusters", value={"u": [0] * 8})
        refused = await peer.hear(lambda m: m.get("id") == 5)
        assert "is held by the autopilot" in json.dumps(refused)


def test_goto_reports_is_cancelled_and_is_replayed(tmp_path):
    recording = tmp_path / "goto.mcap"
    with served("--record", str(recording)) as port:
        ready(port)
        asyncio.run(talk(port))
    result = replay(recording)
    assert result.difference is None
    assert result.hashes > 0
    assert result.requests >= 4
