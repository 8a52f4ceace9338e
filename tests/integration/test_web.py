"""The web view of a real server: said first, over a world that moves, and never what a server fails by."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import signal
import socket
import struct
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from nursery import python
from websockets.asyncio.client import ClientConnection, connect

PATIENCE_S = 120.0
SCENARIO = """\
schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0, 0, 5]
[seabed]
kind = "flat"
depth_m = 20
[adapters.tcp]
kind = "sockets"
port = 0
[server]
metrics = false
"""


@contextlib.contextmanager
def running(folder: Path, text: str = SCENARIO, *options: str) -> Iterator[list[str]]:
    """A server; gives what it has said until peers can connect."""
    (folder / "pool.toml").write_text(text)
    command = [python(), "-m", "uwserver", "run", str(folder / "pool.toml"), *options]
    with (
        (folder / "log").open("w") as log,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True) as process,
    ):
        try:
            assert process.stdout is not None
            said = []
            for line in process.stdout:
                said.append(line.rstrip())
                if line.startswith("Ctrl-C"):
                    break
            else:
                raise AssertionError((folder / "log").read_text())
            yield [line for line in said if line]
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()


def scene_of(page: str) -> dict[str, Any]:
    with urllib.request.urlopen(f"{page}world.json", timeout=PATIENCE_S) as answer:
        return dict(json.loads(answer.read()))


class Page:
    """Live data of a real server: replies by id, states as they come."""

    def __init__(self, stream: ClientConnection) -> None:
        self._stream = stream
        self._id = 0
        self.state = b""

    async def ask(self, method: str, **params: Any) -> Any:
        self._id += 1
        await self._stream.send(json.dumps({"jsonrpc": "2.0", "id": self._id, "method": method, "params": params}))
        while True:
            message = await asyncio.wait_for(self._stream.recv(), PATIENCE_S)
            if isinstance(message, bytes):
                self.state = message
            elif (reply := json.loads(message)).get("id") == self._id:
                assert "error" not in reply, reply
                return reply["result"]

    async def call(self, service: str, **args: Any) -> Any:
        return (await self.ask("call", service=service, args=args))["value"]

    async def until(self, is_so: Any) -> bytes:
        """The first state of which something is so."""

        async def found() -> bytes:
            while not (self.state and is_so(self.state)):
                message = await self._stream.recv()
                if isinstance(message, bytes):
                    self.state = message
            return self.state

        return await asyncio.wait_for(found(), PATIENCE_S)


def head(state: bytes) -> tuple[int, ...]:
    return struct.unpack_from("<BBHIq", state)


def depth(state: bytes, body: int = 0) -> float:
    return float(np.frombuffer(state, "<f4", 3, 16 + 28 * body)[2])


def test_a_page_sees_and_steers_the_world(tmp_path: Path) -> None:
    async def scene(page_url: str) -> None:
        live = page_url.replace("http", "ws") + "live"
        async with connect(live, origin=page_url.rstrip("/")) as stream:  # type: ignore[arg-type]  # an origin
            page = Page(stream)
            await page.ask("hello", version=1, name="helm")
            await page.ask("view", frames=True)
            first = depth(await page.until(lambda state: head(state)[4] > 0))
            await page.call("web/lease/take", vehicle="rov")
            for _ in range(5):
                await page.ask("command", port="rov/thrusters", value={"u": [0, 0, 0, 0, 0.8, 0.8, 0.8, 0.8]})
                await page.call("web/lease/keep")
            moved = await page.until(lambda state: depth(state) > first + 0.05 and max(state[-4:]) > 0)
            achieved = np.frombuffer(moved, np.int8)[-8:]
            assert achieved[4:].min() > 30
            assert not achieved[:4].any()
            await page.call("web/stop")
            await page.until(lambda state: not any(state[-8:]))
            assert head(moved)[3] == scene_of(page_url)["revision"]
            await page.call("world/spawn", name="second", like="rov", p_NB=[9.0, 9.0, 9.0])
            spawned = await page.until(lambda state: head(state)[2] == 2)
            told = await asyncio.get_running_loop().run_in_executor(None, scene_of, page_url)
            assert (told["revision"], [v["name"] for v in told["vehicles"]]) == (head(spawned)[3], ["rov", "second"])
            assert abs(depth(spawned, 1) - 9.0) < 0.1
            await page.call("world/pause")
            stopped = await page.until(lambda state: head(state)[1] == 1)
            assert head(await page.until(lambda state: True))[4] == head(stopped)[4]

    with running(tmp_path, SCENARIO, "--port", "0") as said:
        found = re.fullmatch(r"Open (http://127\.0\.0\.1:(\d+)/)", said[0])
        assert found is not None, said
        assert "uwserver runs" in said[1]
        asyncio.run(scene(found[1]))


def test_a_view_that_cannot_start_ends_no_server_and_is_told_once(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        text = f'{SCENARIO}[adapters.web]\nkind = "web"\nport = {taken.getsockname()[1]}\n'
        with running(tmp_path, text) as said:
            assert not [line for line in said if line.startswith("Open")]
    log = (tmp_path / "log").read_text()
    assert log.count("is in use") == 1


def test_a_scenario_may_have_none(tmp_path: Path) -> None:
    with running(tmp_path, SCENARIO + "web = false\n") as said:
        assert "uwserver runs" in said[0]
        assert not [line for line in said if "http" in line]
