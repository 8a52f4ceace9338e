"""Compiles all kernels with the uwserver of this Python, once, and makes their machine code for each kind of CPU in `LEVELS`.

    python -I tools/emit_kernels.py FOLDER          prints the folder of each machine and level as JSON

Kernels that FOLDER has already, under the hash of all they are made of, are left as they are. On x86-64 the code for aarch64 is made too.
tools/kernel_wheel.py calls this.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

if __name__ == "__main__":
    # Where Embree is not installed our own tree takes its place, and its kernel must be there.
    sys.modules["embreex"] = None  # type: ignore[assignment]

# An interpreter that is isolated (-I) does not look beside the script.
sys.path.append(str(Path(__file__).parent))

import emitting

from uwserver.physics.kernel import compiled, store
from uwserver.world.builds import STAGES, missing
from uwserver.world.warm import COMPILE

KEPT = 24
"""Folders of levels that stay: those of four Pythons, twice."""
FROM = "x86_64"
"""From here code for other machines can be made."""
BASE = "x86-64-v3"
"""The level that the compiling process itself uses."""


def levels() -> list[emitting.Level]:
    """Kinds of CPU that can be served from here."""
    machines = compiled.LEVELS if platform.machine() == FROM else {platform.machine()} & compiled.LEVELS.keys()
    return [emitting.Level(machine, *level) for machine in machines for level in compiled.LEVELS[machine].items()]


def folders(out: Path) -> dict[emitting.Level, Path]:
    """Where the kernels of each kind of CPU go; the names are those in a wheel."""
    physics = Path(compiled.__file__).parents[1]
    return {level: out / f"{compiled.made_of(physics, level.machine)}-{level.name}" for level in levels()}


def compile_here(out: Path, stages: Sequence[str]) -> None:
    """Compile some stages in this process."""
    there = folders(out)
    for folder in there.values():
        folder.mkdir(parents=True, exist_ok=True)
    own = next((level for level in there if level.name == BASE), None)
    emitting.emit(list(there), lambda level, name, body: store.write(there[level], name, body), own)
    for stage in stages:
        COMPILE[stage]()


def shares(stages: Sequence[str], count: int) -> list[list[str]]:
    """Stages for so many processes, which take about the same time."""
    parts: list[list[str]] = [[] for _ in range(count)]
    for stage in sorted(stages, key=lambda stage: -STAGES[stage]):
        min(parts, key=lambda part: sum(STAGES[stage] for stage in part)).append(stage)
    return [part for part in parts if part]


def environment(out: Path) -> dict[str, str]:
    """Settings of the processes that compile: for a kind of CPU, and with a cache of their own."""
    plain = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_", "UWSERVER_"))}
    features = compiled.LEVELS.get(platform.machine(), {}).get(BASE)
    cpu = {} if features is None else {"NUMBA_CPU_NAME": BASE, "NUMBA_CPU_FEATURES": ",".join(f"+{feature}" for feature in features)}  # fmt: skip
    return plain | cpu | {"NUMBA_CACHE_DIR": str(out / "own")}


def check(out: Path) -> None:
    """End with a message if a kernel is missing in this process' cache, or in a folder of `out`."""
    if absent := missing(STAGES):
        sys.exit(f"not all kernels were compiled: {', '.join(absent)}; are the engines of solid things installed?")
    own = compiled.cache_state.folder
    names = {path.name for path in own.glob("*.kernel")} if own is not None else set()
    for level, folder in folders(out).items():
        if lost := names - {path.name for path in folder.glob("*.kernel")}:
            sys.exit(f"{level.name}: {len(lost)} kernels are missing, {min(lost)} for one: remove {out}, and try again")


def prune(out: Path) -> None:
    """Remove the oldest folders."""
    made = sorted((path for path in out.iterdir() if path.name != "own"), key=lambda path: path.stat().st_mtime_ns)
    for old in made[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)


def main() -> None:
    """Compile in processes on all cores, check, print."""
    out, stages = Path(sys.argv[1]), sys.argv[2:]
    if stages == ["check"]:
        check(out)
    elif stages:
        compile_here(out, stages)
    else:
        (out / "own").mkdir(mode=0o700, parents=True, exist_ok=True)
        command = [sys.executable, "-I", __file__, str(out)]
        parts = shares(list(COMPILE), os.cpu_count() or 1)
        running = [subprocess.Popen([*command, *part], env=environment(out)) for part in parts]
        for ended in [process.wait() for process in running]:
            if ended:
                sys.exit(f"a process that compiles kernels ended with {ended}")
        subprocess.run([*command, "check"], env=environment(out), check=True)
        prune(out)
        print(json.dumps([[level.machine, level.name, str(folder)] for level, folder in folders(out).items()]))


if __name__ == "__main__":
    main()
