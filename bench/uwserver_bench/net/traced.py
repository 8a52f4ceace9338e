"""A server that records the time at which each tick ended: ``python -m uwserver_bench.net.traced SCENARIO TRACE``.

TRACE becomes an array of int64, mapped into memory. Element `tick` modulo its length is the monotonic time (ns, the same clock in all processes of
the machine) at which the simulation thread had finished the tick, just before it passed the samples on. With the option ``threads`` there is a
second file, `spent_file` of TRACE; see `Threads`.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from uwserver.adapter import installed_adapters
from uwserver.logs import set_up_logging
from uwserver.ports import Call, Command, Field, Port, Value
from uwserver.scenario.load.scenario import load
from uwserver.sensors import IdealSensor, Scope
from uwserver.server.life_cycle import Options, Server
from uwserver.simulation.clock import SystemTime
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot

if TYPE_CHECKING:
    from uwserver.world.world import World

TICKS = 1 << 16
"""Number of ticks in the trace: more than four minutes at 250 Hz."""
MEGABYTE_HZ = 10
_VALUES = 1 << 17


def open_trace(file: str | Path, mode: str = "r") -> npt.NDArray[np.int64]:
    """Open the trace of a running server ("r"), or a new one ("w+")."""
    return np.memmap(file, dtype=np.int64, mode=mode, shape=(TICKS,))  # type: ignore[call-overload,no-any-return]


def spent_file(trace: str) -> str:
    """Return the file with the times of the threads that belongs to a trace."""
    return f"{trace}.threads"


def open_spent(trace: str, mode: str = "r") -> npt.NDArray[np.int64]:
    """Open the times of the threads of a running server, or a new array. It has a row for each tick; see `Threads`."""
    return np.memmap(spent_file(trace), dtype=np.int64, mode=mode, shape=(TICKS, 3))  # type: ignore[call-overload,no-any-return]


class Threads:
    """Reads the times of two threads, ns: processor time of the loop's thread; time for which this thread or the simulation thread waited for a
    processor that other processes used (0 if the system does not tell); processor time of the simulation thread. Make it on the loop's thread."""

    def __init__(self) -> None:
        self._loop = time.pthread_getcpuclockid(threading.get_ident())
        self._files = [_scheduled(threading.get_native_id())]

    def now(self) -> tuple[int, int, int]:
        """Return all three times. Call it on the simulation thread."""
        if len(self._files) < 2:
            self._files.append(_scheduled(threading.get_native_id()))
        return time.clock_gettime_ns(self._loop), sum(map(_waited, self._files)), time.thread_time_ns()


def _scheduled(thread: int) -> int | None:
    try:
        return os.open(f"/proc/self/task/{thread}/schedstat", os.O_RDONLY)
    except OSError:
        return None


def _waited(file: int | None) -> int:
    return 0 if file is None else int(os.pread(file, 100, 0).split()[1])


class Trace:
    """An observer of the simulation that writes the trace."""

    def __init__(self, ends: npt.NDArray[np.int64], spent: npt.NDArray[np.int64] | None = None) -> None:
        self._ends = ends
        self._spent = spent
        self._threads = Threads()
        self._clock = SystemTime()

    def requested(self, item: Command | Call, tick: int, batch: int) -> None:
        """Do nothing: requests are not recorded."""

    def ticked(self, world: World) -> None:
        """Record the time."""
        at = world.tick % TICKS
        if self._spent is not None:
            self._spent[at] = self._threads.now()
        self._ends[at] = self._clock.now_ns()

    def next_tick(self, tick: int) -> int:
        """Return the next tick: every tick is recorded."""
        return tick + 1


class Megabyte(IdealSensor):
    """A sensor with 2**17 numbers, a megabyte as f64. By the first one a client can check that a sample is complete and the right one."""

    fields = (Field("image", "1", "Numbers that mean nothing.", "S", (_VALUES,)),)
    doc = "A megabyte, to load the ways out."

    def __init__(self) -> None:
        self._values = tuple(k / 7.0 for k in range(_VALUES))

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Return always the same numbers."""
        return True, [self._values]


def install_megabyte(world: World, vehicle: str) -> str:
    """Add a `Megabyte` at 10 Hz to a vehicle, before the world runs. Returns its path."""
    path = f"{vehicle}/megabyte"
    port = Port(path, "sensor", "megabyte", Megabyte.fields, Megabyte.doc, float(MEGABYTE_HZ))
    divisor = round(world.rate_hz / MEGABYTE_HZ)
    member = world.members[vehicle]
    sensor = Megabyte()
    sensor.start(0)
    slot = SensorSlot(sensor, (SensorStream(port),), member.vehicle.row, world.rate_hz, divisor)
    carrier = replace(member, sensors=(*member.sensors, slot))
    world.set_members(carrier if other is member else other for other in world.members.values())
    return path


async def _serve(scenario: str, trace: str, options: list[str]) -> int:
    resolved = load(scenario, adapters=installed_adapters())

    def announce(addresses: dict[str, str]) -> None:
        for stats in server.hub.stats.values():
            addresses |= {key: str(value) for key, value in stats.details.items()}
        print(json.dumps(addresses), flush=True)

    server = Server(resolved, Options(announce=announce))
    spent = open_spent(trace, "w+") if "threads" in options else None
    assert server.live is not None
    server.live.observe(Trace(open_trace(trace, "w+"), spent))
    if "megabyte" in options:
        world = server.live.world
        install_megabyte(world, next(iter(world.vehicles)))
    return await server.run()


def main() -> None:
    """Serve until SIGTERM. Prints the addresses of all adapters as JSON."""
    set_up_logging("error", as_json=False)
    scenario, trace, *options = sys.argv[1:]
    sys.exit(asyncio.run(_serve(scenario, trace, options)))


if __name__ == "__main__":
    main()
