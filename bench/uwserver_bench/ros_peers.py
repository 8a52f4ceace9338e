"""ROS: how soon after a tick peers receive its messages by each transport, how many messages arrive, and whether ticks are late meanwhile."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

from uwserver_bench.net_processes import Traced, traced_server
from uwserver_bench.processes import Load, loading
from uwserver_bench.rows import Row
from uwserver_bench.server import LATENESS_BAR_MS, lateness_p99_ms

LATENCY_BAR_MS, FLOW_BAR, CLIENT_BAR = 1.0, 10_000.0, 980.0
RATE_HZ, IMUS, CLIENTS, DOMAIN = 250, 4, 5, 230
EPOCH_S = 1_767_225_600
"""2026-01-01: the begin of simulation time here."""
TASKS = {"rosbridge": "bridge", "zenoh": "zenoh", "DDS": "dds"}
"""For each transport its adapter, which is also the name of the task that receives."""
_NEEDS = {"rosbridge": "rosbags", "zenoh": "zenoh", "DDS": "cyclonedds"}
_ADAPTERS = {
    "rosbridge": 'kind = "rosbridge"\nport = 0\n',
    "zenoh": f'kind = "ros2"\nlisten = ["tcp/127.0.0.1:0"]\ndomain = {DOMAIN}\n',
    "DDS": f'kind = "ros2"\ntransport = "dds"\nallow_network = true\ndomain = {DOMAIN}\n',
}
_SCENARIO = f"""\
schema = 1
title = "bench ros"

[world]
rate_hz = {RATE_HZ}
epoch_utc = "2026-01-01T00:00:00Z"

[world.clock]
mode = "%s"

[server]
metrics = false

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 20.0]

# The rates of the vehicle file divide 240 Hz. These are the nearest rates that divide {RATE_HZ} Hz.
[vehicles.rov.override.sensors]
imu = {{ rate_hz = 125.0 }}
pressure = {{ rate_hz = 50.0 }}
depth = {{ rate_hz = 50.0 }}

[adapters.tcp]
kind = "sockets"
port = 0
"""


def bench_peers(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Measure four IMUs at 250 Hz: 1000 messages per second. Peers receive them in real time, and in free-run.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    repeats, seconds = (1, 0.5) if quick else (3, 4.0)
    there = [name for name in TASKS if importlib.util.find_spec(_NEEDS[name]) is not None]
    p50: dict[str, list[float]] = {name: [] for name in TASKS}
    flow: dict[str, list[float]] = {name: [] for name in ("zenoh", "DDS")}
    slowest, alone, late = list[float](), list[float](), list[float]()
    with loading("uwserver_bench.ros_load") as load:
        for repeat in range(repeats):
            say(f"ros: peers, repeat {repeat + 1} of {repeats}")
            with traced_server(_scenario("realtime", there)) as traced:
                alone.append(lateness_p99_ms(traced.served))
                for name in there:
                    p50[name].append(_heard(load, traced, name, 1, seconds)["p50_s"] * 1e3)
                if "rosbridge" in there:
                    slowest.append(_heard(load, traced, "rosbridge", CLIENTS, seconds)["per_s"])
                late.append(lateness_p99_ms(traced.served))
            for name in flow.keys() & set(there):
                with traced_server(_scenario("freerun", [name])) as traced:
                    flow[name].append(_heard(load, traced, name, 1, seconds)["per_s"])
    return [
        *(_row(f"{name}: end of the tick to the peer, p50", "ms", name, values, at_most=LATENCY_BAR_MS) for name, values in p50.items()),
        *(
            _row(f"{name}: messages received by one peer, free-running", "1/s", name, values, at_least=FLOW_BAR)
            for name, values in flow.items()
        ),
        _row(f"rosbridge: messages to the slowest of {CLIENTS} clients", "1/s", "rosbridge", slowest, at_least=CLIENT_BAR),
        Row("ros", f"tick lateness p99 at {RATE_HZ} Hz, no peer", "ms", tuple(alone)),
        Row("ros", "tick lateness p99 with all these peers", "ms", tuple(late), at_most=LATENESS_BAR_MS),
    ]  # fmt: skip


def _row(title: str, unit: str, name: str, values: list[float], **bar: float) -> Row:
    note = "" if values else f"not measured: {_NEEDS[name]} is not installed"
    return Row("ros", title, unit, tuple(values), note=note, **bar)


def _heard(load: Load, traced: Traced, name: str, clients: int, seconds: float) -> dict[str, Any]:
    return load.ask(
        TASKS[name], address=traced.addresses[TASKS[name]], clients=clients, seconds=seconds, trace=traced.trace, rate_hz=RATE_HZ,
        epoch_s=EPOCH_S, domain=DOMAIN, topics=[f"/rov/imu{k}" for k in range(IMUS)],
    )  # fmt: skip


def _scenario(mode: str, carriers: list[str]) -> str:
    sensors = "".join(f'\n[vehicles.rov.sensors.imu{k}]\nkind = "imu"\nrate_hz = {RATE_HZ}.0\n' for k in range(IMUS))
    adapters = "".join(f"\n[adapters.{TASKS[name]}]\n{_ADAPTERS[name]}" for name in carriers)
    return _SCENARIO % mode + sensors + adapters
