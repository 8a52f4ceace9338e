"""Runs worlds of one version of uwserver, and measures their processor time. The Python of that version runs it: ``python probe.py``.

Each line on stdin is a task (JSON), and each line on stdout a result. It uses only `uwserver.load`, the documented methods of a world, and the
standard library, so that any version can be measured. It imports nothing of the benchmark, because that version may not have it.
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
    """Load a scenario. Keep its world under a name, if one is given."""
    gc.collect()
    start = time.thread_time_ns()
    world = uwserver.load(task["file"])
    spent = time.thread_time_ns() - start
    if "name" in task:
        worlds[task["name"]] = world
    return spent


def call(task: Task) -> int:
    """Call services of a world, repeated `times`."""
    world = worlds[task["name"]]
    gc.collect()
    start = time.thread_time_ns()
    for _ in range(task.get("times", 1)):
        for service, args in task["calls"]:
            world.call(service, **args)
    return time.thread_time_ns() - start


def step(task: Task) -> int:
    """Step a world. Each of `ports` gets the next of `commands` after every `every` ticks. With `reset` the world is reset first."""
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
