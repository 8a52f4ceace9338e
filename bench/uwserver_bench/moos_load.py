"""The clients of `uwserver bench moos`, in a process of their own: ``python -m uwserver_bench.moos_load``. Its tasks are as of `load`."""

from __future__ import annotations

import contextlib
import selectors
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver_bench.moos_peer import MoosPeer
from uwserver_bench.processes import carry_out
from uwserver_bench.rows import quantile
from uwserver_bench.traced import TICKS, open_trace

TOGETHER = 20
"""Number of doubles in a packet."""
IN_FLIGHT = 4000
_clock = SystemTime()

Task = Mapping[str, Any]


def flow(task: Task) -> dict[str, object]:
    """Let one client write doubles as fast as another receives them, for `seconds`. Returns the received doubles per second."""
    names = [f"FLOW_{k}" for k in range(TOGETHER)]
    with _peers(task, 2) as (writer, reader):
        reader.hear("FLOW_*")
        written = heard = 0
        start = _clock.now_ns()
        end = start + int(task["seconds"] * 1e9)
        while _clock.now_ns() < end:
            while written - heard < IN_FLIGHT:
                writer.write((name, float(written)) for name in names)
                written += TOGETHER
            heard += sum(key.startswith(b"FLOW_") for _, key, _ in reader.receive(0.1))
        return {"per_s": heard / ((_clock.now_ns() - start) * 1e-9), "count": heard}


def navigation(task: Task) -> dict[str, object]:
    """Receive NAV_* for `seconds`. Returns the p99 time (s) from the end of a tick until the client has its position, and the sets per second."""
    ends, late = open_trace(task["trace"]), []
    with _peers(task, 1) as (reader,):
        reader.hear("NAV_X")
        reader.hear("UWSERVER_TIME")
        end = _clock.now_ns() + int(task["seconds"] * 1e9)
        has_position = False
        while _clock.now_ns() < end:
            for at_ns, key, number in reader.receive(0.1):
                if key == b"NAV_X":
                    has_position = True
                elif has_position:  # the time is the last in each packet
                    has_position = False
                    late.append((at_ns - int(ends[round(number * task["rate_hz"]) % TICKS])) * 1e-9)
    late = late[5:]  # the database keeps a set from before the client registered
    if not late:
        raise ValueError("no position came")
    return {"p99_s": quantile(late, 0.99), "per_s": len(late) / task["seconds"]}


def crowd(task: Task) -> dict[str, object]:
    """Let `clients` receive what one client writes at a steady rate, so that `per_s` notifications are sent. Returns how many arrived per second."""
    count = task["clients"]
    names = [f"CROWD_{k}" for k in range(TOGETHER)]
    period = int(1e9 * TOGETHER * count / task["per_s"])
    with _peers(task, count + 1) as (writer, *readers), selectors.DefaultSelector() as selector:
        for reader in readers:
            reader.hear("CROWD_*")
            selector.register(reader, selectors.EVENT_READ, reader)
        start = due = _clock.now_ns()
        end, heard = start + int(task["seconds"] * 1e9), 0
        while (now := _clock.now_ns()) < end:
            if now >= due:
                writer.write((name, 1.0) for name in names)
                due += period
            for key, _ in selector.select(max(0.0, (due - _clock.now_ns()) * 1e-9)):
                heard += sum(name.startswith(b"CROWD_") for _, name, _ in key.data.receive(0.0))
        return {"per_s": heard / ((_clock.now_ns() - start) * 1e-9)}


@contextlib.contextmanager
def _peers(task: Task, count: int) -> Any:
    with contextlib.ExitStack() as stack:
        # The database may not have noticed yet that the clients of the previous task have gone.
        names = [f"bench{_clock.now_ns()}_{k}" for k in range(count)]
        yield [stack.enter_context(contextlib.closing(MoosPeer(task["address"], name))) for name in names]


_TASKS: Mapping[str, Callable[[Task], dict[str, object]]] = {"flow": flow, "navigation": navigation, "crowd": crowd}


def main(lines: Sequence[str] | None = None) -> None:
    """Carry out tasks until stdin ends."""
    carry_out(_TASKS, "load", lines=lines)


if __name__ == "__main__":
    main()
