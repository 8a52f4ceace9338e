"""The how-to of MORSE, on a server of its own: by a client of the same bytes, and by the real pymorse where `UWSERVER_PYMORSE` names its folder."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from nursery import python

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/how-to/morse.md").read_text()
PATIENCE_S = 60


def listings(language: str) -> list[str]:
    """The page's code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """That of requests, of a server that runs the page's scenario on free ports."""
    scenario = tmp_path_factory.mktemp("morse") / "sea.toml"
    first, names, ardupilot = listings("toml")
    free = first.replace('kind = "morse"', 'kind = "morse"\nport = 0\nstream_port = 0')
    free_ports = ardupilot.replace("60900", "0").replace("60901", "0")
    scenario.write_text(free + names + free_ports + "[server]\nweb = false\nmetrics_port = 0\n")
    command = [python(), "-m", "uwserver", "run", str(scenario)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        lines = []
        for line in process.stdout:
            lines.append(line)
            if found := re.search(r"morse: 127\.0\.0\.1:(\d+)", line):
                yield int(found[1])
                break
        else:
            raise AssertionError("".join(lines) + process.stderr.read())
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)


class Caller:
    """Requests of MORSE, one after the other."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
        self._lines = self._socket.makefile("rb")
        self._id = 0

    def __call__(self, component: str, service: str, *args: object) -> Any:
        self._id += 1
        self._socket.sendall(f"{self._id} {component} {service} {json.dumps(args)}\n".encode())
        id, status, *rest = self._lines.readline().decode().rstrip("\n").split(" ", 2)
        value = json.loads(rest[0]) if rest else None
        assert (id, status) == (str(self._id), "SUCCESS"), value
        return value

    def close(self) -> None:
        self._lines.close()
        self._socket.close()


def test_the_page_by_hand(port: int) -> None:
    call = Caller(port)
    call("time", "sleep", 3.0)  # as the page does
    components = call("simulation", "details")["robots"][0]["components"]
    assert {"heavy.pose", "heavy.velocity", "heavy.vw", "heavy.motion", "heavy.waypoint"} <= components.keys()
    pose = call("heavy.pose", "get_local_data")
    assert (pose["x"], pose["y"]) == pytest.approx((0.0, 0.0), abs=0.2)
    assert pose["z"] == pytest.approx(-5.0, abs=1.0)
    before = call("time", "now")
    call("time", "sleep", 0.5)
    assert call("time", "now") >= before + 0.5
    call("heavy", "autopilot_set_mode", "guided")
    call("heavy", "autopilot_arm")
    with socket.create_connection(("127.0.0.1", call("simulation", "get_stream_port", "heavy.motion"))) as motion:
        for _ in range(20):
            motion.sendall(b'{"v": 0.5, "w": 0.0}\n')
            call("time", "sleep", 0.2)
        v = call("heavy.velocity", "get_local_data")
    assert v["linear_velocity"][0] == pytest.approx(0.5, abs=0.1)
    assert v["world_linear_velocity"][1] == pytest.approx(0.5, abs=0.15)  # it heads north
    call.close()


def test_the_page_by_pymorse(port: int) -> None:
    folder = os.environ.get("UWSERVER_PYMORSE")
    if folder is None:
        pytest.skip("UWSERVER_PYMORSE does not name the folder with pymorse (of MORSE's bindings/pymorse/src)")
    if sys.version_info >= (3, 12):
        pytest.skip("pymorse needs asyncore, which Python 3.12 has no more")
    (script,) = listings("py")
    script = script.replace('pymorse.Morse("localhost", 4000)', f'pymorse.Morse("127.0.0.1", {port})')
    # Its own close() raises on 3.11, as the page says.
    script = script.replace("with ", "morse = ").replace(" as morse:", "").replace("\n    ", "\n")
    script += "\nmorse.close(wait_publishers=False)\n"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        env={**os.environ, "PYTHONPATH": folder}, capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "'yaw':" in done.stdout
