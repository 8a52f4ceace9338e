"""Swarms: a hundred complete vehicles with autopilots in free-run, with and without a client; the cost of a sample, of a vehicle and of a thousand
vehicles; and batches of copies.

Rates are simulated time over processor time of one core, or over wall time if more than one core or a client is involved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import median
from threading import Event
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver_bench.processes import Bystanders, Load, Served, loading, scenario_file, serving
from uwserver_bench.report import Row
from uwserver_bench.server import STATUS
from uwserver_bench.swarm.swarm_client import PORTS, RATE_HZ
from uwserver_bench.swarm.swarm_scenario import SERVED, has_threads, scenario
from uwserver_bench.swarm.swarm_threads import bench_threads

BARS = {1: 400.0, 10: 60.0, 100: 6.0}
"""Simulated over processor time, by number of vehicles."""
TWO_CORES_BAR, THRUST_BAR = 10.0, 45.0
CLIENT_BAR = 0.7
"""Least rate with a client, as a part of BARS and of the rate without a client."""
NOISE_BAR_US, SAMPLE_BAR_US = 0.3, 0.7
AT_ONCE = 100
LARGE, LARGE_BAR, LARGE_MEMORY_BAR_MB, LARGE_LOAD_BAR_S = 1000, 1.0, 1500.0, 10.0
COUNTS = (10, 500, LARGE)
"""Numbers of vehicles between which the growth of the cost is measured."""
QUICK_COUNTS = (10, 100)
QUICK_SERVERS = (1, 10)
EXPONENT_BAR, MEMORY_EXPONENT_BAR = 1.1, 1.2
"""The second one is higher, because it depends on differences of process sizes: 1 MB changes it by 0.04."""
MEMORY_BAR_KB = 200.0
COPIES, QUICK_COPIES = 1024, 64
COPIED = {"physics": ((), 1.0e6), "IMU, depth, DVL and AHRS": (("imu", "depth", "dvl", "ahrs"), 3.0e5)}
"""Cases of batches: the sensors that measure, and the bar in vehicle-steps per second on two cores."""
BOTTOM_BAR = 0.5
"""Least rate of copies over a bottom, to which their DVLs have lock, as a part of the rate in open water."""
UNREAD_BAR = 0.9
"""Least rate of a world in a program that reads no samples, as a part of the rate in a server without clients."""
UNKNOWN = "not measured: this system has no /proc"

_Say = Callable[[str], None]


def bench_swarm(quick: bool, say: _Say) -> list[Row]:
    """Return the part of the report on swarms.

    Args:
        quick: short repeats, without the world of a thousand vehicles and the server of a hundred.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    effort = {"seconds": 0.02, "repeats": 1} if quick else {"seconds": 1.0, "repeats": 5}
    return [
        *_fleets(effort, say),
        *_with_a_client(QUICK_SERVERS if quick else tuple(BARS), 1 if quick else 3, 0.5 if quick else 4.0, say),
        *_unread(QUICK_SERVERS if quick else tuple(BARS), effort, say),
        *_alone(effort, say),
        *bench_threads(quick, say),
        *_samples(effort, say),
        *_growth(QUICK_COUNTS if quick else COUNTS, effort, say),
        *_copies(QUICK_COPIES if quick else COPIES, effort, say),
    ]


def _world(task: str, **arguments: object) -> dict[str, Any]:
    """Carry out a task of `swarm_world` in a new process, and return the result."""
    with loading("uwserver_bench.swarm.swarm_world") as load:
        return load.ask(task, **arguments)


def _vehicles(count: int) -> str:
    return f"{count} vehicle{'s' if count > 1 else ''}"


def _fleets(effort: dict[str, Any], say: _Say) -> list[Row]:
    """Measure complete vehicles on their missions, without a reader; and the memory of one vehicle."""
    rows, memory = [], {}
    for count, bar in BARS.items():
        say(f"swarm: {_vehicles(count)} with sensors and autopilot")
        found = _world("fly", kind="navigation", vehicles=count, one_core=True, **effort)
        rates, memory[count] = tuple(found["of_processor_time"]), found["resident_mb"]
        rows.append(Row("swarm", f"{_vehicles(count)}, sensors and autopilot, one core", "x realtime", rates, bar))
    if has_threads():
        say(f"swarm: {_vehicles(count)} with sensors and autopilot, all cores")
        found = _world("fly", kind="navigation", vehicles=count, one_core=False, **effort)
        rates = tuple(found["of_wall_time"])
        title = f"{_vehicles(count)}, sensors and autopilot, all cores, wall time"
        rows.append(Row("swarm", title, "x realtime", rates, TWO_CORES_BAR))
    few, many = sorted(memory)[-2:]
    known = memory[few] is not None and memory[many] is not None
    of_one = ((memory[many] - memory[few]) * 1e3 / (many - few),) if known else ()
    title = "memory of a vehicle with sensors and autopilot"
    rows.append(Row("swarm", title, "kB", of_one, at_most=MEMORY_BAR_KB, note="" if known else UNKNOWN))
    return rows


def _unread(counts: Sequence[int], effort: dict[str, Any], say: _Say) -> list[Row]:
    """Measure the cost of samples that a program does not read."""
    rows = []
    for kind, what in (("navigation", "sensors and autopilot"), ("bluerov2_qgc", "as in bluerov2_qgc")):
        for count in counts:
            say(f"swarm: {_vehicles(count)}, {what}, in a program that reads nothing")
            found = _world("unread", kind=kind, vehicles=count, **effort)
            title = f"{_vehicles(count)}, {what}: in a program that reads nothing, of a server without clients"
            rows.append(Row("swarm", title, "ratio", tuple(found["ratio"]), UNREAD_BAR))
    return rows


def _with_a_client(counts: Sequence[int], repeats: int, seconds: float, say: _Say) -> list[Row]:
    """Measure free-running servers alternately with and without a client in another process. For comparison with a process that only
    computes, because cores that share caches, clock or units slow each other down whatever the server does."""
    rows, busy = [], []
    for count in counts:
        alone, crowded, beside, samples = [], [], [], []
        text = scenario("navigation", count) + SERVED
        with scenario_file(text) as file, loading("uwserver_bench.swarm.swarm_client") as client:
            with serving(file, options=("--mode", "freerun")) as served:
                say(f"swarm: {_vehicles(count)} in a server")
                client.do("set_out", served, vehicles=count)
                for repeat in range(repeats):
                    say(f"swarm: {_vehicles(count)} with and without a client, {repeat + 1} of {repeats}")
                    bystanders = Bystanders(served.pid)
                    alone.append(_rate(served, seconds))
                    busy += [cores] if (cores := bystanders.cores()) is not None else []
                    with_client, told = _meanwhile(served, client, "follow", count, seconds)
                    crowded.append(with_client)
                    samples.append(told["samples_per_s"])
                    beside.append(_meanwhile(served, client, "compute", count, seconds)[0])
        left, left_by_others = (
            tuple(b / a for a, b in zip(alone, with_others, strict=True)) for with_others in (crowded, beside)
        )
        title = f"server of {_vehicles(count)}"
        rows += [
            Row("swarm", f"{title}, nobody connected, wall time", "x realtime", tuple(alone)),
            Row(
                "swarm", f"{title}, a client takes {len(PORTS)} ports of each at {RATE_HZ:g} Hz", "x realtime", tuple(crowded),
                CLIENT_BAR * BARS[count],
            ),
            Row("swarm", f"{title}: what the client leaves of the rate", "ratio", left, CLIENT_BAR),
            Row("swarm", f"{title}: what a process that only computes leaves of it", "ratio", left_by_others),
            Row("swarm", f"{title}: samples to the client, a simulated second", "1/s", tuple(samples)),
        ]  # fmt: skip
    title = "other work on this machine meanwhile (none: idle)"
    return [*rows, Row("swarm", title, "cores", tuple(busy), note="" if busy else UNKNOWN)]


def _meanwhile(served: Served, client: Load, what: str, count: int, seconds: float) -> tuple[float, dict[str, Any]]:
    """Return the rate while the client process carries out a task, and the result of the task."""
    task = {"host": served.host, "port": served.port, "vehicles": count, "seconds": seconds + 1.0}
    client.begin(what, **task)
    SystemTime().wait(0.5, Event())
    rate = _rate(served, seconds)
    return rate, client.result()


def _rate(served: Served, seconds: float) -> float:
    """Return simulated over wall time of a server."""
    begin, since = int(served.ask(STATUS)["t_ns"]), SystemTime().now_ns()
    SystemTime().wait(seconds, Event())
    return (int(served.ask(STATUS)["t_ns"]) - begin) / (SystemTime().now_ns() - since)


def _alone(effort: dict[str, Any], say: _Say) -> list[Row]:
    """Measure physics and thrusters alone."""
    say("swarm: physics and thrusters alone")
    title = "100 vehicles, physics and thrusters alone"
    alone = _world("thrust", vehicles=100, one_core=True, **effort)
    found = _world("thrust", vehicles=100, one_core=False, **effort)
    note = "" if found["threads"] > 1 else "stepped by one thread: another did not pay here"
    return [
        Row("swarm", f"{title}, one core", "x realtime", tuple(alone["of_processor_time"])),
        Row(
            "swarm", f"{title}, all cores, wall time", "x realtime", tuple(found["of_wall_time"]), THRUST_BAR, note=note
        ),
    ]


def _samples(effort: dict[str, Any], say: _Say) -> list[Row]:
    """Measure the cost of one sample in a world with many sensors of a kind."""
    say("swarm: samples of many sensors at once")
    found = _world("read", vehicles=AT_ONCE, **effort | {"seconds": 0.2 * effort["seconds"]})
    noise, sample = tuple(found["noise_us"]), tuple(found["sample_us"])
    return [
        Row("swarm", "white noise on a 3-vector, a sample", "us", noise, at_most=NOISE_BAR_US),
        Row("swarm", f"IMU sample with all errors, of {AT_ONCE} at once", "us", sample, at_most=SAMPLE_BAR_US),
    ]


def _growth(counts: Sequence[int], effort: dict[str, Any], say: _Say) -> list[Row]:
    """Measure worlds of vehicles with IMU and depth sensor: how the cost grows with their number, and the cost of the largest world."""
    tick_s, resident = [], []
    for count in counts:
        say(f"swarm: {_vehicles(count)} with IMU and depth")
        found = _world("fly", kind="simple", vehicles=count, one_core=True, **effort)
        tick_s.append(1.0 / median(found["of_processor_time"]))
        resident.append(found["resident_mb"])
    exponent = math.log(tick_s[-1] / tick_s[0]) / math.log(counts[-1] / counts[0])
    title = f"exponent of cost from {counts[0]} to {counts[-1]} vehicles"
    rows = [Row("swarm", title, "", (exponent,), at_most=EXPONENT_BAR)]
    if counts[-1] == LARGE:
        say(f"swarm: {_vehicles(2 * LARGE)} with IMU and depth, for their memory")
        twice = _world("fly", kind="simple", vehicles=2 * LARGE, one_core=True, **effort | {"repeats": 1})
        rows += _memory_growth((*counts, 2 * LARGE), (*resident, twice["resident_mb"]))
        if has_threads():
            found = _world("fly", kind="simple", vehicles=LARGE, one_core=False, **effort)
        memory = () if found["resident_mb"] is None else (found["resident_mb"],)
        title = f"{_vehicles(LARGE)} with IMU and depth"
        rows += [
            Row("swarm", f"{title}, wall time", "x realtime", tuple(found["of_wall_time"]), LARGE_BAR),
            Row("swarm", f"{title}: memory", "MB", memory, at_most=LARGE_MEMORY_BAR_MB, note="" if memory else UNKNOWN),
            Row("swarm", f"{title}: load", "s", (found["load_s"],), at_most=LARGE_LOAD_BAR_S),
        ]
    return rows


def _memory_growth(counts: Sequence[int], resident: Sequence[float | None]) -> list[Row]:
    """Measure the same for memory, by what the last vehicles add: the first ones use room that the process has anyway."""
    known = [mb for mb in resident if mb is not None][-3:]
    if len(known) < 3:
        return []
    few, many = [(b - a) / (n - m) for (m, a), (n, b) in pairwise(zip(counts[-3:], known, strict=True))]
    title = f"exponent of memory from {counts[-3]} to {counts[-1]} vehicles"
    exponent: tuple[float, ...] = ()
    note = "the first vehicles took no memory that the process had not"
    if few > 0.0 and many > 0.0:
        exponent, note = (1.0 + math.log(many / few) / math.log(counts[-1] / counts[-2]),), ""
    return [Row("swarm", title, "", exponent, at_most=MEMORY_EXPONENT_BAR, note=note)]


def _copies(copies: int, effort: dict[str, Any], say: _Say) -> list[Row]:
    """Measure a batch of BlueROV2 Heavy in open water, commanded ten times per second."""
    rows = []
    for what, (sensors, bar) in COPIED.items():
        say(f"swarm: batch of {copies}, {what}")
        found = _world("copy", kind="copied", copies=copies, sensors=sensors, **effort)
        title = f"batch of {copies} BlueROV2 Heavy, {what}, all cores, wall time"
        rows.append(Row("swarm", title, "vehicle-steps/s", tuple(found["steps_per_s"]), bar))
    say(f"swarm: batch of {copies}, over a bottom")
    over = _world("copy", kind="over a bottom", copies=copies, sensors=sensors, **effort)
    ratios = tuple(b / a for a, b in zip(found["steps_per_s"], over["steps_per_s"], strict=True))
    title = f"batch of {copies} BlueROV2 Heavy, {what}: over a bottom, of open water"
    rows.append(Row("swarm", title, "ratio", ratios, BOTTOM_BAR))
    return [*rows, Row("swarm", f"batch of {copies} BlueROV2 Heavy: load", "s", (found["load_s"],))]
