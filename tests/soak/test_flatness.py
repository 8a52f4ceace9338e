"""Whatever is done again and again leaves nothing behind: memory, descriptors and threads are as before."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from gauges import Usage, own_usage, processor_s, usage
from server_process import PATIENCE_S, Audience, Peer, serving

import uwserver
from uwserver.world import World

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

ROUND = 40
KEPT = 8
MEGABYTE = 1 << 20
Cycle = Callable[[World, int], None]


def spawn_and_remove(world: World, n: int) -> None:
    world.call("world/spawn", name=f"guest{n}", like=next(iter(world.vehicles)), p_NB=[2.0, 1.0, 1.0])
    world.step(2)
    world.call("world/remove", name=f"guest{n}")


def keep_and_go_back(world: World, n: int) -> None:
    world.call("world/snapshot", name=f"s{n % KEPT}")
    world.step(1)
    world.call("world/restore", name=f"s{n % KEPT}")


def reset(world: World, n: int) -> None:
    world.step(3)
    world.call("world/reset")


def fail_and_mend(world: World, n: int) -> None:
    parameters = {"fraction": -0.02}
    target = next(iter(world.vehicles))
    world.call("world/set_fault", name=f"f{n}", kind="buoyancy_change", target=target, parameters=parameters)
    world.step(1)
    world.call("world/clear_fault", name=f"f{n}")


def growth(cycle: Cycle, cycles: int, warm_up: int) -> float:
    """Bytes of resident memory that each cycle has cost, after some that may have built what is kept."""
    world = uwserver.load("pool_inspection").core
    before = 0
    for n in range(warm_up + cycles):
        if n == warm_up:
            before = own_usage().memory
        cycle(world, n)
    assert len(world.hydro) <= len(world.members) + 1, "rows of who is gone are used again"
    return (own_usage().memory - before) / cycles


CYCLES: dict[str, tuple[Cycle, int]] = {
    "spawn and remove": (spawn_and_remove, 10_000),
    "snapshot and restore": (keep_and_go_back, 10_000),
    "reset": (reset, 1000),
    "fault": (fail_and_mend, 1000),
}


@pytest.mark.parametrize("what", CYCLES)
def test_a_cycle_leaves_nothing(what: str) -> None:
    assert growth(CYCLES[what][0], 3 * ROUND, 2 * ROUND) < 6000.0


@pytest.mark.slow
@pytest.mark.parametrize("what", CYCLES)
def test_thousands_of_cycles_leave_nothing(what: str) -> None:
    cycle, times = CYCLES[what]
    assert growth(cycle, times, 5 * ROUND) * times < 8 * MEGABYTE


def test_the_gauge_sees_what_is_left_behind() -> None:
    left: list[bytes] = []
    assert growth(lambda world, n: left.append(bytes(10_000)), 3 * ROUND, ROUND) > 6000.0


def come_and_go(cycles: int) -> tuple[float, int, int]:
    """Growth of a server: bytes a client, descriptors and threads in all."""
    with serving("pool_inspection", "--speed", "2", program=sys.executable) as (address, pid):
        clerk = Peer(address)

        def visit(n: int) -> None:
            peer = Peer(address)
            peer.ask("hello", version=1, name=f"visitor {n}")
            peer.ask("subscribe", pattern="**")
            if n % 3:
                peer.ask("command", port="bluerov2/thrusters", value={"u": [0.1] * 8})
            peer.close()

        for n in range(150):
            visit(n)
        before = _settled(pid, clerk)
        for n in range(cycles):
            visit(n)
        after = _settled(pid, clerk)
        clerk.close()
    return (
        (after.memory - before.memory) / cycles,
        after.descriptors - before.descriptors,
        after.threads - before.threads,
    )


def _settled(pid: int, clerk: Peer) -> Usage:
    """Once all but one are gone, which takes their connections a moment."""
    end = time.monotonic() + PATIENCE_S
    while clerk.call("world/status")["result"]["value"]["adapters"]["tcp"]["peers"] > 1:
        assert time.monotonic() < end, "visitors are still there"
        time.sleep(0.05)
    return usage(pid)


def test_clients_that_come_and_go_leave_nothing() -> None:
    memory, descriptors, threads = come_and_go(300)
    assert memory < 6000.0
    assert descriptors <= 1
    assert threads == 0


@pytest.mark.slow
def test_ten_thousand_clients_leave_nothing() -> None:
    memory, descriptors, threads = come_and_go(10_000)
    assert memory * 10_000 < 8 * MEGABYTE
    assert descriptors <= 1
    assert threads == 0


CROWDED = """
schema = 1
title = "Fast sensors"

[world]
rate_hz = 250

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]

[vehicles.rov.truth]
rate_hz = 250

[vehicles.rov.override.sensors.imu]
rate_hz = 250

[vehicles.rov.override.sensors.pressure]
rate_hz = 250

[vehicles.rov.override.sensors.depth]
rate_hz = 250

[adapters.tcp]
kind = "sockets"
port = 7600
truth = true
"""


def tick_cost(pid: int, peer: Peer, seconds: float) -> float:
    """Processor time of the simulation thread for a tick, s: of the threads beside the main one, the busiest."""
    ticks, before = peer.call("world/status")["result"]["value"]["tick"], processor_s(pid)
    time.sleep(seconds)
    after = processor_s(pid)
    ticks = peer.call("world/status")["result"]["value"]["tick"] - ticks
    return max(after[task] - before.get(task, 0.0) for task in after if task != pid) / ticks


@pytest.mark.slow
def test_a_hundred_slow_subscribers_delay_no_tick(tmp_path: Path) -> None:
    path = tmp_path / "crowded.toml"
    path.write_text(CROWDED)
    with serving(path, program=sys.executable) as (address, pid):
        peer = Peer(address)
        alone = tick_cost(pid, peer, 10.0)
        audience = Audience(address, 100, pause_s=0.01)
        time.sleep(5.0)
        before = usage(pid)
        crowded = tick_cost(pid, peer, 20.0)
        after = usage(pid)
        status = peer.call("world/status")["result"]["value"]
        audience.leave()
        peer.close()
    print(
        f"tick {1e6 * alone:.0f} us alone, {1e6 * crowded:.0f} us crowded; {before} to {after}; {status['adapters']['tcp']}"
    )
    # A share of the machine's caches is theirs; a tick of 250 Hz lasts 4 ms.
    assert crowded < 2.0 * alone + 500e-6
    assert after.memory - before.memory < 32 * MEGABYTE
    assert after.threads == before.threads
    assert status["adapters"]["tcp"]["dropped"] > 1000, "the slow ones are told how much they lost"
