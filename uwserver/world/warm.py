"""Compiles every kernel ahead of the first run; ``python -m uwserver.world.warm``."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from uwserver.physics import warm as physics
from uwserver.physics.kernel.compiled import cache_state
from uwserver.world.builds import STAGES, prepare, progress, watch_parent
from uwserver.world.stepping import kernel_stages

COMPILE: dict[str, Callable[[], object]] = physics.COMPILE | {
    stage: partial(kernel_stages.load, stage) for stage in kernel_stages.STAGES
}
"""Compiles the kernels of each stage."""

_KEPT = 16
"""Caches of other versions that stay, 3 MB each: other installations and checkouts may use them, and wheels are made of them."""


def prune(folder: Path) -> list[Path]:
    """Remove the oldest caches beside `folder` that other versions of the sources have left. Returns the removed ones."""
    others = [path for path in folder.parent.glob("kernels-*") if path != folder]
    old = sorted(others, key=lambda path: path.stat().st_mtime_ns, reverse=True)[_KEPT:]
    for path in old:
        shutil.rmtree(path, ignore_errors=True)
    return [path for path in old if not path.exists()]


def warm(say: Callable[[str], None] = lambda line: None) -> bool:
    """Compile the kernels that the cache lacks, on all cores, and run each path of the physics kernels once.

    Args:
        say: takes a line of progress before each part.

    Returns:
        Whether anything had to be compiled.

    Raises:
        RuntimeError: the kernels ran and a state was not finite: the installation is broken.
    """
    say("kernels: loading the compiler")
    compiled = prepare(STAGES, progress())
    physics.check(say)
    say("kernels: sensors and autopilots")
    for stage in kernel_stages.STAGES:
        kernel_stages.load(stage)
    return compiled


def compile_for_parent(arguments: Sequence[str], compile_stage: Mapping[str, Callable[[], object]]) -> None:
    """Do the work of a process of `builds.start`, with its arguments: ``--nice N STAGE...``."""
    os.nice(int(arguments[1]))
    watch_parent()
    for stage in arguments[2:]:
        compile_stage[stage]()


def _main(stages: Sequence[str]) -> None:
    if stages:
        compile_for_parent(stages, COMPILE)
        return
    state = cache_state
    if state.reason:
        print(state.reason, file=sys.stderr)
    compiled = warm(lambda line: print(line, flush=True))
    if state.folder is not None and not state.reason:
        prune(state.folder)
    done = "compiled" if compiled else "were ready"
    print(f"kernels: {done} in {state.folder or 'memory only'}")


if __name__ == "__main__":
    _main(sys.argv[1:])
