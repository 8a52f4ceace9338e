"""An autopilot in the loop: frames per second in lock-step, in free-run and in real time, with physics and sensors."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.world.warm import warm
from uwserver_bench.processes import loading, scenario_file, serving
from uwserver_bench.report import Row
from uwserver_bench.server import STATUS

FREE_BAR, RATE_HZ = 4000.0, 1200.0
_LOAD = "uwserver_bench.autopilots.sil_load"
_SETTLE_S = 1.0

_SCENARIO = """\
schema = 1
title = "bench sil"
[world]
rate_hz = 1200
[world.clock]
mode = "lockstep"
lockstep_clients = ["autopilot"]
{pace}
[server]
metrics = false
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 20.0]
[vehicles.rov.truth]
rate_hz = 1200
[vehicles.rov.sensors.imu]
kind = "imu"
profile = "mems_imu"
rate_hz = 1200
latency_s = 0.0
[vehicles.rov.sensors.dvl]
kind = "dvl"
profile = "a50"
rate_hz = 8
[adapters.tcp]
kind = "sockets"
port = 0
[adapters.autopilot]
kind = "ardupilot_json"
port = 0
truth = true
no_time_sync = true
"""


def bench_sil(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on autopilots in the loop.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    warm()
    repeats, seconds = (1, 0.5) if quick else (3, 5.0)
    free, _ = _run("", repeats, seconds, say)
    paced, lost = _run("max_speed = 1.0", repeats, 4 * seconds, say)
    return [
        Row("sil", "ArduPilot JSON, free-running: frames, each a tick", "1/s", free, at_least=FREE_BAR),
        Row("sil", f"ArduPilot JSON, real time: frames of {RATE_HZ:g} a second", "1/s", paced, at_least=0.999 * RATE_HZ),
        Row("sil", "frames repeated or lost meanwhile", "1", lost, at_most=0.0),
    ]  # fmt: skip


def _run(
    pace: str, repeats: int, seconds: float, say: Callable[[str], None]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the frames per second of each repeat, and the numbers of frames that were repeated or lost."""
    rates, lost = list[float](), list[float]()
    text = _SCENARIO.format(pace=pace)
    with scenario_file(text) as scenario, serving(scenario) as served, loading(_LOAD) as load:
        stats = served.ask(STATUS)["value"]["adapters"]["autopilot"]
        task = {"address": stats["address"], "first": 0, "source": 0}
        task |= _next(load.ask("frames", **task, seconds=_SETTLE_S))
        before = 0.0
        for repeat in range(repeats):
            say(f"sil, {pace or 'free-running'}: repeat {repeat + 1} of {repeats}")
            result = load.ask("frames", **task, seconds=seconds)
            task |= _next(result)
            details = served.ask(STATUS)["value"]["adapters"]["autopilot"]["details"]
            total = float(details["duplicates"] + details["lost"])
            rates.append(result["per_s"])
            lost.append(total - before)
            before = total
    return tuple(rates), tuple(lost)


def _next(result: dict[str, object]) -> dict[str, object]:
    return {"first": result["next"], "source": result["source"]}
