"""Measures what a new user waits for, from nothing to the first sample, by stage: in a clean folder, with an empty cache of kernels.

    python tools/first_minute.py --dist dist  wheels of `make dist` in a fresh environment, the default scenario, all kernels, a second environment
    python tools/first_minute.py              the same with pure wheels of this checkout, whose kernels are compiled
    python tools/first_minute.py --clone      `make run` in a clone of this checkout instead
    python tools/first_minute.py --check      exits with 1 where a bar is missed; they hold for an idle machine of two cores

Each line has the wall time, the processor time and how many kernels were compiled; on a busy machine, whose load is printed, only the second means
something. pip may use its cache of downloads.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import wheels
from wheels import ROOT

import uwserver

FIRST_SAMPLE = ("run", "--port", "0", "--mode", "freerun", "--until", "0.1")
BARS_S = {
    "our own work": 30.0,
    "wheel to first sample": 40.0,
    "clone to first sample": 60.0,
    "all kernels": 100.0,
    "second environment": 10.0,
}
"""Wall time at most. Our own work is the first start, without what pip does before. A start with finished kernels takes some seconds itself, so the
last one is not zero."""
TIMEOUT_S = 1800.0


class Stage(NamedTuple):
    """One line of the report."""

    name: str
    wall_s: float
    cpu_s: float
    kernels: int


def timed(name: str, command: Sequence[str | Path], environment: dict[str, str], cwd: Path) -> Stage:
    """Run a command that must succeed, with all that it starts."""
    known = kernels_in(environment)
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(
        list(map(str, command)),
        env=environment,
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    if done.returncode != 0:
        sys.exit(f"{name}: {' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Stage(name, time.monotonic() - begun, cpu_s, len(kernels_in(environment) - known))


def kernels_in(environment: dict[str, str]) -> set[Path]:
    """Those that were compiled, in the user's cache."""
    return set(Path(environment["XDG_CACHE_HOME"]).rglob("*.kernel"))


def clean_environment(work: Path) -> dict[str, str]:
    """Without the settings of this checkout, and with an empty cache of kernels."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_", "VIRTUAL_ENV"))}
    return kept | {
        "XDG_CACHE_HOME": str(work / "cache"),
        "PIP_CACHE_DIR": os.environ.get("PIP_CACHE_DIR") or pip_cache(),
    }


def pip_cache() -> str:
    """Where pip keeps its downloads: they are no part of the measurement."""
    return subprocess.run(
        [sys.executable, "-m", "pip", "cache", "dir"], capture_output=True, text=True, timeout=60, check=True
    ).stdout.strip()


def checkout_wheels() -> Path:
    """Folder of the pure wheels of this checkout."""
    try:
        return wheels.folder()
    except wheels.Fault as fault:
        sys.exit(str(fault))


def of_wheel(work: Path, environment: dict[str, str], dist: Path | None) -> Iterator[Stage]:
    """Wheels, as a user installs them; then all kernels, and another environment of the same version."""
    # As from a package index, pip takes the wheel for this platform, if there is one.
    wanted = (
        "--quiet",
        "--find-links",
        str((dist or checkout_wheels()).resolve()),
        f"uwserver=={uwserver.__version__}",
    )
    yield timed("create environment", (sys.executable, "-m", "venv", "one"), environment, work)
    yield timed("pip install", ("one/bin/pip", "install", *wanted), environment, work)
    yield timed("first sample", ("one/bin/uwserver", *FIRST_SAMPLE), environment, work)
    yield timed("start again", ("one/bin/uwserver", *FIRST_SAMPLE), environment, work)
    yield timed("all other kernels", ("one/bin/python", "-m", "uwserver.world.warm"), environment, work)
    subprocess.run([sys.executable, "-m", "venv", "two"], cwd=work, env=environment, check=True, timeout=TIMEOUT_S)
    subprocess.run(["two/bin/pip", "install", *wanted], cwd=work, env=environment, check=True, timeout=TIMEOUT_S)
    yield timed("second environment", ("two/bin/uwserver", *FIRST_SAMPLE), environment, work)


def of_clone(work: Path, environment: dict[str, str]) -> Iterator[Stage]:
    """`make run` in a clone, until its first sample."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), "clone"], cwd=work, check=True, timeout=TIMEOUT_S)
    yield timed("make ready", ("make", "ready"), environment, work / "clone")
    arguments = " ".join(FIRST_SAMPLE[1:])
    yield timed("make run", ("make", "run", f"ARGS={arguments}"), environment, work / "clone")


def sums(stages: Sequence[Stage], clone: bool) -> dict[str, float]:
    """What the bars are for, s of wall time."""
    wall = {stage.name: stage.wall_s for stage in stages}
    if clone:
        return {"clone to first sample": sum(wall.values())}
    first = ("create environment", "pip install", "first sample")
    return {
        "our own work": wall["first sample"],
        "wheel to first sample": sum(wall[name] for name in first),
        "all kernels": wall["first sample"] + wall["all other kernels"],
        "second environment": wall["second environment"],
    }


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clone", action="store_true", help="`make run` in a clone instead of a wheel")
    parser.add_argument("--dist", type=Path, help="wheels as `make dist` left them in a folder")
    parser.add_argument("--check", action="store_true", help="exit with 1 where a bar is missed")
    options = parser.parse_args()
    stages: list[Stage] = []
    with tempfile.TemporaryDirectory(prefix="uwserver-first-minute-") as name:
        work = Path(name)
        environment = clean_environment(work)
        print(f"{os.cpu_count()} cpus, load {os.getloadavg()[0]:.1f}", flush=True)
        for stage in of_clone(work, environment) if options.clone else of_wheel(work, environment, options.dist):
            stages.append(stage)
            compiled = f", {stage.kernels} kernels compiled" if stage.kernels else ""
            print(f"{stage.name:24}{stage.wall_s:8.1f} s{stage.cpu_s:8.1f} s of processor time{compiled}", flush=True)
    missed = bool(stages[-1].kernels) and not options.clone
    if missed:
        print("a second environment of the same version compiled kernels again")
    for bar, seconds in sums(stages, options.clone).items():
        missed |= seconds > BARS_S[bar]
        print(f"{bar:24}{seconds:8.1f} s, bar {BARS_S[bar]:.0f} s: {'missed' if seconds > BARS_S[bar] else 'met'}")
    return 1 if missed and options.check else 0


if __name__ == "__main__":
    sys.exit(main())
