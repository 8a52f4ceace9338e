"""A server in a process of its own, for tests with autopilots."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import pytest
from nursery import python

PATIENCE_S = 60.0

PRESSURE_50_HZ = """
[vehicles.rov.sensors.pressure]
kind = "pressure"
rate_hz = 50
[vehicles.rov.sensors.depth]
kind = "pressure"
output = "depth"
rate_hz = 50
"""
"""Those of the vehicle file have 48 Hz, which divides neither 1000 nor 400."""

SCENARIO = """
schema = 1
[world]
rate_hz = {rate}
[world.clock]
mode = "lockstep"
lockstep_clients = ["autopilot"]
{clock}
[environment]
density_kgpm3 = 1025
[server]
metrics = false
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0, 0, {depth}]
[vehicles.rov.truth]
rate_hz = {rate}
[vehicles.rov.sensors.imu]
kind = "imu"
profile = "mems_imu"
rate_hz = {imu}
latency_s = 0.0
{sensors}
[adapters.tcp]
kind = "sockets"
port = 0
truth = true
[adapters.autopilot]
port = {port}
truth = true
{adapter}
"""


class Server:
    """A server in a process of its own, and what it says over its native wire."""

    def __init__(self, process: subprocess.Popen[str], addresses: dict[str, tuple[str, int]]) -> None:
        self.process = process
        self.addresses = addresses
        self._wire = socket.create_connection(addresses["tcp"], timeout=PATIENCE_S)
        self._lines = self._wire.makefile("r", encoding="utf-8")
        self._id = 0
        self._samples: dict[str, dict[str, Any]] = {}

    def ask(self, method: str, **params: Any) -> Any:
        self._id += 1
        request = {"jsonrpc": "2.0", "id": self._id, "method": method, "params": params}
        self._wire.sendall(json.dumps(request).encode() + b"\n")
        while True:
            answer = json.loads(self._lines.readline())
            if answer.get("method") == "sample":
                self._samples[answer["params"]["port"]] = answer["params"]["value"]
            if answer.get("id") == self._id:
                assert "error" not in answer, answer
                return answer["result"]

    def call(self, service: str, **args: Any) -> Any:
        return self.ask("call", service=service, args=args).get("value")

    def status(self) -> dict[str, Any]:
        return dict(self.call("world/status"))

    def stats(self, adapter: str = "autopilot") -> dict[str, Any]:
        return dict(self.status()["adapters"][adapter])

    def follow(self, port: str) -> None:
        """Take in a sensor from now on."""
        self.ask("subscribe", pattern=port, rate_hz=50)

    def last(self, port: str) -> dict[str, Any]:
        """Newest value of a sensor that is followed."""
        self.ask("ping")
        return self._samples[port]

    def close(self) -> None:
        self._lines.close()
        self._wire.close()


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def run(scenario: str, folder: Path, errors: IO[str]) -> subprocess.Popen[str]:
    """`uwserver run` in a folder."""
    command = [python(), "-m", "uwserver", "run", scenario]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, cwd=folder, env=environment)


def addresses(process: subprocess.Popen[str], errors: IO[str]) -> dict[str, tuple[str, int]]:
    """Where its adapters are to be found, once it serves."""
    found: dict[str, tuple[str, int]] = {}
    assert process.stdout is not None
    for line in process.stdout:
        match = re.fullmatch(r"  (\w+): (\S+):(\d+)\n", line)
        if match:
            found[match[1]] = match[2], int(match[3])
        if line.startswith("Ctrl-C"):
            return found
    errors.seek(0)
    pytest.fail(f"the server did not start: {errors.read()}")


@contextlib.contextmanager
def serving(folder: Path, text: str) -> Iterator[Server]:
    """Run a scenario until the test is over; its end must be in order."""
    file = folder / "autopilot.toml"
    file.write_text(text)
    with (folder / "errors").open("w+") as errors:
        process = run(str(file), folder, errors)
        try:
            server = Server(process, addresses(process, errors))
            try:
                yield server
            finally:
                server.close()
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.communicate(timeout=PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
        errors.seek(0)
        assert "Traceback" not in errors.read()


def ardusub_scenario(
    port: int = 0, rate: int = 1200, depth: float = 5.0, clock: str = "", adapter: str = "", sensors: str = ""
) -> str:
    return SCENARIO.format(
        rate=rate,
        imu=rate,
        port=port,
        depth=depth,
        clock=clock,
        adapter=f'kind = "ardupilot_json"\n{adapter}',
        sensors=sensors,
    )


def until(condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    end = time.monotonic() + patience_s
    while not (value := condition()):
        assert time.monotonic() < end, f"not within {patience_s:g} s: {what}"
        time.sleep(0.02)
    return value
