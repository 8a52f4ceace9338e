"""`uwserver bench hostile`: decoders, then floods against a running server. Each flood is compared with an undisturbed time of the same length."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwserver.simulation.clock import SystemTime
from uwserver.world.warm import warm
from uwserver_bench.hostile.decoding import costs
from uwserver_bench.hostile.floods import FLOODS, HAS_MAVLINK, MAVLINK, RATE_HZ, SCENARIO, Flood
from uwserver_bench.net.net_processes import Traced, traced_server
from uwserver_bench.net.traced import TICKS, open_spent, open_trace
from uwserver_bench.processes import Load, loading
from uwserver_bench.report import Row

DELAY_BAR_MS = 2.0
TICK_NS = 10**9 // RATE_HZ
_SETTLE_S = 1.0
_LOAD = "uwserver_bench.hostile.load"


def bench_hostile(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on attacks.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    rows = costs(quick, say)
    warm()
    repeats, seconds = (1, 0.5) if quick else (3, 2.0)
    text = SCENARIO + (MAVLINK if HAS_MAVLINK else "")
    with loading(_LOAD) as load, traced_server(text, "threads", is_quiet=True) as target:
        SystemTime().wait(_SETTLE_S, Event())
        for flood in FLOODS.values():
            say(f"hostile: {flood.name}")
            rows += _flooded(flood, target, load, repeats, seconds)
    return rows


class Delay(NamedTuple):
    """Delays of the ticks during some time, ms.

    Attributes:
        gap: longest time between the ends of two ticks.
        ours: longest delay of a tick by our own work. It is limited by the processor time of the loop's thread meanwhile, plus that of the simulation
            thread beyond the median of a tick; and by the delay minus the time for which our threads waited for a processor.
        others: the rest of the longest gap without the time of a tick: other processes used the processors.
    """

    gap: float
    ours: float
    others: float


def _delay(target: Traced, start_ns: int, end_ns: int) -> Delay:
    """Return the delays of the ticks of a server that ended within this time."""
    return delay_of(np.asarray(open_trace(target.trace)), np.asarray(open_spent(target.trace)), start_ns, end_ns)


def delay_of(ends: npt.NDArray[np.int64], spent: npt.NDArray[np.int64], start_ns: int, end_ns: int) -> Delay:
    """Return the delays of the ticks that ended within a time.

    Args:
        ends: end times of the ticks, ns, in any order.
        spent: times of the threads until each of them (`uwserver_bench.net.traced.Threads`).
        start_ns, end_ns: the time.
    """
    found = np.flatnonzero((ends >= start_ns) & (ends <= end_ns))
    found = found[np.argsort(ends[found])]
    if len(found) < 2:
        whole = (end_ns - start_ns) * 1e-6
        return Delay(whole, whole, 0.0)  # without times of threads all counts as ours
    gaps = np.diff(ends[found])
    looped, waited, ticked = np.diff(spent[found], axis=0).T
    late = np.maximum(0, gaps - TICK_NS)
    worked = looped + np.maximum(0, ticked - int(np.median(ticked)))
    ours = np.minimum(worked, np.maximum(0, late - waited))
    longest = int(np.argmax(gaps))
    return Delay(float(gaps.max()) * 1e-6, float(ours.max()) * 1e-6, float(late[longest] - ours[longest]) * 1e-6)


def _flooded(flood: Flood, target: Traced, load: Load, repeats: int, seconds: float) -> list[Row]:
    if flood.address not in target.addresses:
        return [Row("flood", flood.name, "ms", (), note=f"not measured: the server has no {flood.address}")]
    clock = SystemTime()
    calm: list[Delay] = []
    flooded: list[Delay] = []
    sent = opened = 0
    assert seconds * 2 < TICKS / RATE_HZ
    for _ in range(repeats):
        start = clock.now_ns()
        clock.wait(seconds, Event())
        middle = clock.now_ns()
        result = load.ask("attack", flood=flood.name, address=target.addresses[flood.address], seconds=seconds)
        end = clock.now_ns()
        if not result["opened"]:
            return [Row("flood", flood.name, "ms", (), note=f"not measured: no connection ({result['reason']})")]
        calm.append(_delay(target, start, middle))
        flooded.append(_delay(target, middle, end))
        sent += int(result["bytes"])
        opened += int(result["opened"])
        clock.wait(_SETTLE_S, Event())
    taken = f"{sent / (repeats * seconds) * 1e-6:.1f} MB/s were taken, {opened} connections"
    return [
        Row("flood", f"{flood.name}: longest gap of ticks, undisturbed", "ms", tuple(each.gap for each in calm)),
        Row("flood", f"{flood.name}: longest gap of ticks, flooded", "ms", tuple(each.gap for each in flooded), note=taken),
        Row("flood", f"{flood.name}: of it for want of a processor", "ms", tuple(each.others for each in flooded)),
        Row("flood", f"{flood.name}: what work of ours can delay a tick", "ms", tuple(each.ours for each in flooded), at_most=DELAY_BAR_MS),
    ]  # fmt: skip
