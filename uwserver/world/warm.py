"""Compiles every kernel, so that no server has to; ``python -m uwserver.world.warm``."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from uwserver.physics import warm as physics
from uwserver.physics.kernel.compiled import cache_state
from uwserver.world import banks
from uwserver.world.builds import STAGES, prepare, progress, watch_parent

COMPILE: dict[str, Callable[[], object]] = {**physics.COMPILE, **banks.COMPILE}
"""What compiles the kernels of a stage, and no others."""

_KEPT = 16
"""Caches of other versions, 3 MB each, that stay: other installations and checkouts may be at work with them, and wheels are made of them."""


def prune(folder: Path) -> list[Path]:
    """Remove the oldest caches that other versions of the sources left beside `folder`; returns what was removed."""
    others = [path for path in folder.parent.glob("kernels-*") if path != folder]
    old = sorted(others, key=lambda path: path.stat().st_mtime_ns, reverse=True)[_KEPT:]
    for path in old:
        shutil.rmtree(path, ignore_errors=True)
    return [path for path in old if not path.exists()]


def warm(say: Callable[[str], None] = lambda line: None) -> bool:
    """Compile what the cache lacks, on all cores, and run each path of those of physics once.

    Args:
        say: gets a line of progress before each part.

    Returns:
        Whether anything had to be compiled.

    Raises:
        RuntimeError: the kernels ran and a state was not finite: the installation is broken.
    """
    say("kernels: loading the compiler")
    compiled = prepare(STAGES, progress())
    physics.check(say)
    say("kernels: sensors and autopilots")
    for stage in banks.COMPILE:
        COMPILE[stage]()
    return compiled


def compile_for_parent(arguments: Sequence[str], compile_stage: Mapping[str, Callable[[], object]]) -> None:
    """Be one of the processes of `builds.start`, with its arguments: ``--nice N STAGE...``."""
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
