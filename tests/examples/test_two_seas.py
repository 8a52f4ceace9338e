"""Two servers that see each other's vehicle, stepped in turn so that the delay between them is known; one is killed and comes back."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path.insert(0, str(EXAMPLES))

from two_seas import Sea, carry  # noqa: E402
from uwclient import AsyncClient  # noqa: E402

PATIENCE_S = 120.0
TICKS = 4
"""Of a round: a sample of the truth at 60 Hz. A pose is so old, at most, when the other server has made its round."""
HZ = 240.0


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


class Server:
    """A paused server of one sea, in a process of its own."""

    def __init__(self, vehicle: str, folder: Path) -> None:
        self.sea = Sea(vehicle, "127.0.0.1", free_port())
        text = (EXAMPLES / f"two_seas_{vehicle}.toml").read_text().split("[adapters.web]")[0]
        port = next(line for line in text.splitlines() if line.startswith("port = "))
        self._scenario = folder / f"{vehicle}.toml"
        self._scenario.write_text(
            text.replace(port, f"port = {self.sea.port}") + "\n[server]\nmetrics = false\nweb = false\n"
        )
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "uwserver", "run", str(self._scenario), "--paused"]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(PATIENCE_S)


@contextlib.asynccontextmanager
async def stepper(server: Server) -> AsyncIterator[AsyncClient]:
    """A client that steps it."""
    sea = server.sea
    async with await AsyncClient.connect(sea.host, sea.port, timeout=PATIENCE_S) as client:
        for vehicle in ("north", "south"):
            await client.subscribe(f"{vehicle}/truth/*", delivery="latest")
        yield client


async def step(client: AsyncClient, vehicle: str, carried: Counter[str]) -> None:
    """A round of one server, until the other one has been told of its vehicle."""
    before, end = carried[vehicle], asyncio.get_running_loop().time() + PATIENCE_S
    await client.step(TICKS)
    while carried[vehicle] == before:
        assert asyncio.get_running_loop().time() < end, f"nobody carried {vehicle}"
        await asyncio.sleep(0.005)


async def step_until_heard(client: AsyncClient, vehicle: str, carried: Counter[str]) -> None:
    """Rounds of one server until the other one is told of it again: whoever comes anew hears the next sample, not the last."""
    before = carried[vehicle]
    for _ in range(round(PATIENCE_S / 0.1)):
        await client.step(TICKS)
        await asyncio.sleep(0.1)
        if carried[vehicle] != before:
            return
    raise AssertionError(f"nobody carried {vehicle}")


def gap(one: AsyncClient, other: AsyncClient, vehicle: str) -> float:
    """Distance of a vehicle in two seas, m."""
    places = [client.latest(f"{vehicle}/truth/pose") for client in (one, other)]
    assert None not in places
    return math.dist(*(place.vector("p_NB") for place in places if place is not None))


def speed(client: AsyncClient, vehicle: str) -> float:
    sample = client.latest(f"{vehicle}/truth/velocity")
    assert sample is not None
    return math.hypot(*sample.vector("v_NB_B"))


async def act(north: Server, south: Server) -> None:
    carried: Counter[str] = Counter()
    told = lambda vehicle: carried.update([vehicle])  # noqa: E731
    tasks = [asyncio.create_task(carry(*pair, told)) for pair in ((north.sea, south.sea), (south.sea, north.sea))]
    try:
        async with stepper(north) as one:
            async with stepper(south) as two:
                await step_until_heard(one, "north", carried)
                await step_until_heard(two, "south", carried)
                await rounds(one, two, carried)
            south.kill()
            await one.step(300)  # longer than a gap: who is silent is gone
            lost = one.latest("south/truth/pose")
            assert lost is not None
            assert lost.vector("p_NB")[2] < -1e6
            south.start()
            async with stepper(south) as two:
                await step_until_heard(one, "north", carried)
                await step_until_heard(two, "south", carried)
                await rounds(one, two, carried)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def rounds(one: AsyncClient, two: AsyncClient, carried: Counter[str]) -> None:
    """Each sees the other within the way that it makes in the delay and a tick."""
    for _ in range(30):
        await step(one, "north", carried)
        await step(two, "south", carried)
    for own, other, vehicle in ((one, two, "north"), (two, one, "south")):
        v = speed(own, vehicle)
        assert v > 0.01
        assert gap(own, other, vehicle) <= v * (TICKS + 1) / HZ + 1e-4


@pytest.mark.slow
def test_each_server_sees_the_vehicle_of_the_other_also_after_one_was_killed(tmp_path):
    servers = [Server("north", tmp_path), Server("south", tmp_path)]
    try:
        asyncio.run(asyncio.wait_for(act(*servers), 4 * PATIENCE_S))
    finally:
        for server in servers:
            server.kill()
