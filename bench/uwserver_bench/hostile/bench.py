"""`uwserver bench hostile`: decoders, then floods against a running server, each beside an undisturbed time of the same length."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from threading import Event

import numpy as np

from uwserver.physics.warm import warm
from uwserver.simulation.clock import SystemTime
from uwserver_bench.hostile.decoding import costs
from uwserver_bench.hostile.floods import FLOODS, HAS_MAVLINK, MAVLINK, SCENARIO, Flood
from uwserver_bench.processes import BenchFailed, Load, loading, stop
from uwserver_bench.rows import Row
from uwserver_bench.traced import TICKS, open_trace

ADDED_BAR_MS = 2.0
_SETTLE_S = 1.0
_LOAD = "uwserver_bench.hostile.load"


def bench_hostile(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """The hostile part of the report.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not do its part.
    """
    rows = costs(quick, say)
    warm()
    repeats, seconds = (1, 0.5) if quick else (3, 2.0)
    with loading(_LOAD) as load, _serving() as target:
        for flood in FLOODS.values():
            say(f"hostile: {flood.name}")
            rows += _flooded(flood, target, load, repeats, seconds)
    return rows


@dataclass(frozen=True)
class Target:
    """A running server: its addresses by name, and its trace of ticks."""

    addresses: dict[str, str]
    trace: str

    def longest_gap_ms(self, start_ns: int, end_ns: int) -> float:
        """Longest time between the ends of two ticks, of those that ended within this time, ms."""
        ends = np.sort(np.asarray(open_trace(self.trace)))
        within = ends[(ends >= start_ns) & (ends <= end_ns)]
        if len(within) < 2:
            return (end_ns - start_ns) * 1e-6
        return float(np.diff(within, prepend=start_ns, append=end_ns).max()) * 1e-6


@contextlib.contextmanager
def _serving() -> Iterator[Target]:
    with tempfile.TemporaryDirectory(prefix="uwserver-bench-") as folder:
        scenario, trace = Path(folder) / "hostile.toml", str(Path(folder) / "trace")
        scenario.write_text(SCENARIO + (MAVLINK if HAS_MAVLINK else ""), encoding="utf-8")
        command = [sys.executable, "-m", "uwserver_bench.traced", str(scenario), trace]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
            try:
                assert process.stdout is not None
                said = process.stdout.readline()
                if not said:
                    raise BenchFailed("the traced server did not start")
                SystemTime().wait(_SETTLE_S, Event())
                yield Target(json.loads(said), trace)
            finally:
                stop(process)


def _flooded(flood: Flood, target: Target, load: Load, repeats: int, seconds: float) -> list[Row]:
    if flood.address not in target.addresses:
        return [Row("flood", flood.name, "ms", (), note=f"not measured: the server has no {flood.address}")]
    clock = SystemTime()
    calm: list[float] = []
    flooded: list[float] = []
    sent = 0
    assert seconds * 2 < TICKS / 240
    for _ in range(repeats):
        start = clock.now_ns()
        clock.wait(seconds, Event())
        middle = clock.now_ns()
        result = load.ask("attack", flood=flood.name, address=target.addresses[flood.address], seconds=seconds)
        end = clock.now_ns()
        calm.append(target.longest_gap_ms(start, middle))
        flooded.append(target.longest_gap_ms(middle, end))
        sent += int(result["bytes"])
        clock.wait(_SETTLE_S, Event())
    added = tuple(there - before for there, before in zip(flooded, calm, strict=True))
    megabytes = f"{sent / (repeats * seconds) * 1e-6:.1f} MB/s were taken"
    return [
        Row("flood", f"{flood.name}: longest gap of ticks, undisturbed", "ms", tuple(calm)),
        Row("flood", f"{flood.name}: longest gap of ticks, flooded", "ms", tuple(flooded), note=megabytes),
        Row("flood", f"{flood.name}: what the flood adds", "ms", added, at_most=ADDED_BAR_MS),
    ]
