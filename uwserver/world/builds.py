"""Compiles the kernels that a world needs, in processes on all cores, and shows the progress."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import NamedTuple

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
_SETTLED = 2.0
"""Wall time (s) after which the pace so far is trusted: before, the processes import."""
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


class Progress(NamedTuple):
    """How far a stage is: the processor time that its process has used, and `STAGES`' estimate of all that it will use, s."""

    spent: float
    estimate: float

    def left(self, slowness: float) -> float:
        """Return the processor time that is still needed, s. One that has used more than expected needs at least a tenth of that more.

        Args:
            slowness: slowness of this machine: processor time over its estimate.
        """
        return max(slowness * self.estimate - self.spent, 0.1 * self.spent)


def _run(todo: Sequence[str], workers: int, tell: Tell) -> None:
    waiting, done = list(todo), list[Progress]()
    running: dict[str, subprocess.Popen[bytes]] = {}
    spent: dict[str, float] = {}
    elapsed = 0.0
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                stage = waiting.pop(0)
                running[stage] = start([stage])
            for stage, process in [*running.items()]:
                spent[stage] = processor_time(process.pid) or spent.get(stage, 0.0)
                if process.poll() is not None:
                    stop(running.pop(stage))
                    done.append(Progress(spent[stage], STAGES[stage]))
            under_way = [Progress(spent[stage], STAGES[stage]) for stage in running]
            left = time_left([STAGES[stage] for stage in waiting], under_way, done, workers, elapsed)
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


def time_left(
    waiting: Sequence[float], running: Sequence[Progress], done: Sequence[Progress], workers: int, elapsed: float
) -> float:
    """Return about how much wall time (s) compiling will still take.

    It is judged by the processor time that the machine has given so far, so that it stays true while other programs run beside it.

    Args:
        waiting: estimates of the stages that have not begun, s of processor time.
        running, done: the other stages.
        workers: how many processes run at a time.
        elapsed: wall time since the beginning, s.
    """
    if not waiting and not running:
        return 0.0
    known = sum(stage.estimate for stage in done)
    slowness = sum(stage.spent for stage in done) / known if known and all(stage.spent for stage in done) else 1.0
    needed = [stage.left(slowness) for stage in running]
    spent = sum(stage.spent for stage in (*running, *done))
    # Processor seconds a second: what the machine has given, once there is enough to tell.
    given = spent / elapsed if elapsed > _SETTLED and spent > 0.0 else float(workers)
    whole = (slowness * sum(waiting) + sum(needed)) / given
    longest = max([*needed, *(slowness * estimate for estimate in waiting)])
    return max(whole, longest * max(1.0, min(workers, len(running) or 1) / given), 1.0)


def processor_time(pid: int) -> float:
    """Return the processor time that a process has used, s; 0 where the system does not tell."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return 0.0


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
