"""Runs worlds of one version of uwserver, and tells their processor time: run by that version's Python, ``python probe.py``.

One task a line on stdin (JSON), one result a line on stdout. It uses nothing but `uwserver.load` and the documented methods of a world, and
the standard library, so that any version can be measured; and it imports nothing of the benchmark, which that version may not have.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import uwserver

worlds: dict[str, Any] = {}
Task = Mapping[str, Any]


def load(task: Task) -> int:
    """Load a scenario, and keep its world under a name if one is given."""
    gc.collect()
    start = time.thread_time_ns()
    world = uwserver.load(task["file"])
    spent = time.thread_time_ns() - start
    if "name" in task:
        worlds[task["name"]] = world
    return spent


def call(task: Task) -> int:
    """Call services of a world, `times` over."""
    world = worlds[task["name"]]
    gc.collect()
    start = time.thread_time_ns()
    for _ in range(task.get("times", 1)):
        for service, args in task["calls"]:
            world.call(service, **args)
    return time.thread_time_ns() - start


def step(task: Task) -> int:
    """Let time go on; each of `ports` gets the next of `commands` after every `every` ticks. From the start of the scenario, if `reset`."""
    world, commands, every = worlds[task["name"]], task["commands"], task["every"]
    if task["reset"]:
        world.call("world/reset")
    gc.collect()
    world.step(2)
    start = time.thread_time_ns()
    for turn in range(task["turns"]):
        for k, port in enumerate(task["ports"]):
            world.command(port, u=commands[(turn + k) % len(commands)])
        world.step(every)
    return time.thread_time_ns() - start


TASKS: Mapping[str, Callable[[Task], int]] = {"load": load, "call": call, "step": step}


def main() -> None:
    """Carry out tasks until stdin ends."""
    for line in sys.stdin:
        task = json.loads(line)
        try:
            answer: dict[str, object] = {"ns": TASKS[task["do"]](task)}
        except Exception as error:  # noqa: BLE001  # whatever that version says belongs into the report
            answer = {"failed": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
