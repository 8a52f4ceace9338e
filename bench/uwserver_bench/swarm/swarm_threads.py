"""A second thread of a world: how soon it begins with its part of a loop, and whether it makes ticks in real time late."""

from __future__ import annotations

import platform
from collections.abc import Callable
from statistics import median
from threading import Event
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from uwserver.physics.kernel.arrays import Array, IntArray
from uwserver.physics.kernel.atomics import load_atomic, pause, store_atomic
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.sharing import share
from uwserver.physics.kernel.team import Team, why_alone
from uwserver.simulation.clock import SystemTime
from uwserver_bench.processes import loading, scenario_file, serving
from uwserver_bench.report import Row, quantile
from uwserver_bench.server import ACTIVE, SILENT, lateness_p99_ms
from uwserver_bench.swarm.swarm_scenario import SERVED, names, scenario

START_BAR_US = 5.0
VEHICLES = 30
"""Vehicles in the world whose lateness is measured: enough that their loops are shared."""
ADDED_BAR_MS = 0.3
_COMMAND = (
    f'{{"jsonrpc":"2.0","id":1,"method":"command","params":{{"port":"{names(1)[0]}/thrusters",'
    '"value":{"u":[0.1,0.1,-0.1,-0.1,0.2,0.2,0.2,0.2]}}}'
)
_PATIENCE = 1_000_000  # about 30 ms: a thread that has not begun by then is not counted
_ASLEEP_S = 0.002
"""After this time a thread that waits for work is asleep."""
_clock = SystemTime()

_Say = Callable[[str], None]


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def _cycles(_context: Any) -> Any:
    """Return the time stamp counter of the processor, which is the same on all cores."""

    def generate(context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(64), [])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.readcyclecounter"), [])

    return types.int64(), generate


@compiled
def _meet(first: int, end: int, me: int, times: Array) -> None:
    for k in range(first, end):
        if k > 0:
            if me != 0:
                store_atomic(times, 1, _cycles())
            continue
        turns = 0
        while load_atomic(times, 1) == 0 and turns < _PATIENCE:
            pause()
            turns += 1


@entry
def _start(team: Array, times: Array) -> None:
    """Share a loop of two rows. `times` receives the time of the start, and the time at which the other thread began, or 0 if it did not."""
    times[1] = 0
    times[0] = _cycles()
    share(team, _meet, (times,), 2, 1)


@entry
def _read_cycles(times: Array) -> None:
    times[0] = _cycles()


def starts_us(count: int, pause_s: float) -> list[float]:
    """Return how long another thread takes to begin, us, for each of `count` tries. Nothing is shared for `pause_s` between two tries."""
    team, times = Team(2), np.zeros(2, np.int64)
    team.begin()
    team.shares = True
    try:
        us = 1e6 / _cycles_per_s(times)
        found = []
        for _ in range(count):
            if pause_s:
                _clock.wait(pause_s, Event())
            _start(team.numbers, times)
            if times[1]:
                found.append(us * float(times[1] - times[0]))
        return found
    finally:
        team.end()


def _cycles_per_s(times: IntArray) -> float:
    spans = []
    for _ in range(5):
        _read_cycles(times)
        before, begin = int(times[0]), _clock.now_ns()
        _clock.wait(0.01, Event())
        _read_cycles(times)
        spans.append((int(times[0]) - before) / ((_clock.now_ns() - begin) * 1e-9))
    return median(spans)


def bench_threads(quick: bool, say: _Say) -> list[Row]:
    """Return the rows on threads; none if a second thread is of no use.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    why = why_alone()
    if why:
        return [Row("swarm", "another thread begins with its share after", "us", (), at_most=START_BAR_US, note=why)]
    return [*_starts(quick, say), *_lateness(1 if quick else 3, 0.5 if quick else 4.0, say)]


def _starts(quick: bool, say: _Say) -> list[Row]:
    if platform.machine() not in ("x86_64", "AMD64"):
        return []
    say("swarm: how soon another thread begins")
    starts_us(10, 0.0)
    awake, asleep = starts_us(200 if quick else 5000, 0.0), starts_us(20 if quick else 300, _ASLEEP_S)
    title = "another thread begins with its share after"
    return [
        Row("swarm", f"{title}, loops in turn", "us", (median(awake),) if awake else (), at_most=START_BAR_US),
        Row("swarm", f"{title}, loops in turn, p99", "us", (quantile(awake, 0.99),) if awake else ()),
        Row("swarm", f"{title}, asleep before", "us", (median(asleep),) if asleep else ()),
        Row("swarm", f"{title}, asleep before, p99", "us", (quantile(asleep, 0.99),) if asleep else ()),
    ]


def _lateness(pairs: int, seconds: float, say: _Say) -> list[Row]:
    """Measure servers of the same world in real time, alternately with one thread and with two, each with clients."""
    late: dict[int, list[float]] = {1: [], 2: []}
    with loading() as load:
        for pair in range(pairs):
            for threads, found in late.items():
                say(f"swarm: lateness with {threads} of 2 threads, {pair + 1} of {pairs}")
                text = scenario("navigation", VEHICLES).replace("threads = 1\n", f"threads = {threads}\n") + SERVED
                with scenario_file(text) as file, serving(file) as served:
                    load.do("clients", served, active=ACTIVE, silent=SILENT, seconds=seconds, request=_COMMAND)
                    found.append(lateness_p99_ms(served))
    # Two measurements differ by more than this, so the difference may be negative.
    added = tuple(max(0.0, two - one) for one, two in zip(late[1], late[2], strict=True))
    title = f"tick lateness p99, {VEHICLES} vehicles, {ACTIVE} active clients, {SILENT} that never read"
    return [
        Row("swarm", f"{title}, one thread", "ms", tuple(late[1])),
        Row("swarm", f"{title}, two", "ms", tuple(late[2])),
        Row("swarm", "what the second thread adds to it", "ms", added, at_most=ADDED_BAR_MS),
    ]
