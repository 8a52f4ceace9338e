"""Compiles the kernels that a world needs, in processes on all cores, and shows the progress."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Collection, Sequence

from uwserver.physics.collision.engine import missing_engine
from uwserver.physics.kernel import compiled
from uwserver.physics.kernel.compiled import ENTRY_KERNELS
from uwserver.world.stepping import kernel_stages

STAGES = {
    "fins in contact": 12.0, "fins": 12.0, "solids": 18.0, "contact": 10.0, "free": 8.0, "echoes": 4.0, "sea": 4.0,
    "sensors": 12.0, "soundings": 9.0, "sonars": 12.0, "sound": 5.0, "pictures": 8.0, "autopilots": 10.0,
    "cameras": 25.0, "copies": 2.0,
}  # fmt: skip
"""The stages in which kernels are compiled, one for each thing that a world may have. The number is the processor time (s) that a stage
takes alone on a 2.5 GHz Xeon."""

Tell = Callable[[str, bool], None]
"""Takes a line of progress, and whether it is the last one."""

_PERIOD = 0.2  # s between two checks of the processes
_PREFIX = "uwserver: compiling the physics for this machine, once"


def kernels_of(stage: str) -> tuple[str, ...]:
    """Return the names of the kernels of a stage, as the cache has them."""
    return ENTRY_KERNELS.get(stage) or kernel_stages.kernels_of(stage)


def missing(stages: Collection[str]) -> tuple[str, ...]:
    """Return those of some stages that are not compiled yet, the longest first. The stage of solids counts only if a collision engine is
    installed."""
    here = [stage for stage in STAGES if stage in stages and (stage != "solids" or missing_engine() is None)]
    needed = {stage: kernels_of(stage) for stage in here}
    absent = set(compiled.cache_state.missing([kernel for kernels in needed.values() for kernel in kernels]))
    todo = [stage for stage in here if not absent.isdisjoint(needed[stage])]
    return tuple(sorted(todo, key=lambda stage: -STAGES[stage]))


def prepare(stages: Collection[str], tell: Tell) -> bool:
    """Compile the missing kernels of some stages into the user's cache. Without a cache, each kernel is compiled when it is first needed.

    Args:
        stages: names from `STAGES`.
        tell: takes the progress; it is not called if nothing is missing.

    Returns:
        Whether anything was missing.
    """
    todo = missing(stages)
    if not todo:
        return False
    workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if compiled.cache_state.folder is None or compiled.cache_state.reason:
        tell(f"{_PREFIX}, in memory: about {sum(STAGES[stage] for stage in todo):.0f} s", True)
        return True
    _run(todo, workers, tell)
    return True


def _run(todo: Sequence[str], workers: int, tell: Tell) -> None:
    waiting, done = list(todo), 0.0
    running: dict[str, subprocess.Popen[bytes]] = {}
    elapsed = 0.0
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                stage = waiting.pop(0)
                running[stage] = start([stage])
            for stage in [stage for stage, process in running.items() if process.poll() is not None]:
                stop(running.pop(stage))
                done += STAGES[stage]
            left = _left([*waiting, *running], workers, done, elapsed)
            ready = len(todo) - len(waiting) - len(running)
            tell(f"{_PREFIX}: {ready} of {len(todo)} parts ready, about {left:.0f} s left", left == 0.0)
            if running:
                try:
                    next(iter(running.values())).wait(_PERIOD)
                except subprocess.TimeoutExpired:
                    elapsed += _PERIOD
    finally:
        for process in running.values():
            stop(process)


def _left(stages: Sequence[str], workers: int, done: float, elapsed: float) -> float:
    """Return about how many seconds some stages will take, judged by the pace so far."""
    if not stages:
        return 0.0
    whole = max(sum(STAGES[stage] for stage in stages) + done, 1e-9) / workers
    longest = max(STAGES[stage] for stage in stages)
    pace = max(1.0, elapsed * workers / done) if done else 1.0
    return max(max(whole, longest) * pace - elapsed, 1.0)


def start(stages: Sequence[str], nice: int = 0) -> subprocess.Popen[bytes]:
    """Start a process that compiles some stages and ends with this one."""
    command = [sys.executable, "-m", "uwserver.world.warm", "--nice", str(nice), *stages]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    null = subprocess.DEVNULL
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=null, stderr=null, env=environment)


def stop(process: subprocess.Popen[bytes]) -> None:
    """Kill a process of `start`. A kernel that is half compiled is not kept."""
    process.kill()
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


def watch_parent() -> None:
    """End this process as soon as its parent is gone, for whatever reason. Called in the processes of `start`."""

    def wait() -> None:
        # `sys.stdin` would read through a buffer with a lock. An interpreter that ends while this thread holds the lock would abort.
        os.read(sys.stdin.fileno(), 1)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def progress() -> Tell:
    """Return a function that shows progress to a person: on a terminal one line that is overwritten, in a log only the first line."""
    stream, said = sys.stderr, [""]

    def tell(text: str, last: bool) -> None:
        if stream.isatty():
            end = "\n" if last else ""
            stream.write(f"\r{text:<{len(said[0])}}{end}")
            stream.flush()
        elif not said[0]:
            print(text, file=stream, flush=True)
        said[0] = text

    return tell
