"""Tries uwserver with the other CPythons of this machine; exits with 1 if anything failed there.

Each gets a fresh environment with the wheels and, there: doctor, checks, the default scenario, every scenario with something solid, the codecs,
and the contacts with the engine that this Python has. What uwserver depends on is installed once for each Python, into the user's cache, and
anew when what is needed changes; kernels likewise compile once. Versions that are not on the machine are skipped, with a line that says so.
The time of each part is printed: on the wall, and of the processors.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
VERSIONS = ("3.10", "3.12", "3.13")
EXTRAS = "solid"
TESTING = ("pytest>=8.2", "hypothesis>=6.100", "msgpack>=1.0", "jsonschema>=4.20", "pyserial>=3.5")
PROJECTS = {"uwserver": ROOT, "uwclient": ROOT / "clients" / "python"}
SOLID = ("pool_inspection", "subsea_template", "slope", "push_the_crate", "remus_survey", "one_of_everything")
TESTS = (
    "tests/unit/ports",
    "tests/unit/adapter",
    "tests/unit/adapters/native",
    "tests/unit/adapters/moos",
    "tests/unit/physics/collision/test_engine.py",
    "tests/unit/physics/collision/test_solids.py",
    "tests/physics/test_contact.py",
)
RUN_TESTS = """import os, sys
import pytest
os.chdir(sys.argv[1])
sys.path.append("bench")  # where the proofs are
sys.exit(pytest.main(["-q", "-m", "not slow", "-p", "no:cacheprovider", *sys.argv[2:]]))
"""
"""As a file: with `python -m pytest` the checkout would stand before the wheel."""
BORROW = "import site; site.addsitedir({!r})\n"
KEPT = 2
"""Environments kept of each Python; the oldest go."""
TIMEOUT_S = 900.0


class Failed(Exception):
    """A command that did not succeed, with what it printed."""


def interpreter(version: str) -> Path | None:
    """Python of a version: below `pyenv root`, else on the PATH; None if there is none."""
    for root in _pyenv_roots():
        found = sorted(root.glob(f"versions/{version}.*/bin/python"), key=_numbers)
        if found:
            return found[-1]
    there = shutil.which(f"python{version}")
    if there is None or subprocess.run([there, "-c", ""], capture_output=True, timeout=60.0, check=False).returncode:
        return None  # pyenv leaves a shim of each version that any folder uses
    return Path(there)


def _numbers(path: Path) -> list[int]:
    return [int(part) for part in path.parents[1].name.split(".") if part.isdigit()]


def _pyenv_roots() -> Iterator[Path]:
    if os.environ.get("PYENV_ROOT"):
        yield Path(os.environ["PYENV_ROOT"])
    if shutil.which("pyenv"):
        yield Path(subprocess.run(["pyenv", "root"], capture_output=True, text=True, check=True).stdout.strip())


def run(*command: str | Path, cwd: Path) -> str:
    """Output of a command that must succeed, without the settings of this checkout."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        list(map(str, command)),
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    if done.returncode != 0:
        raise Failed(
            f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout[-8000:]}{done.stderr[-8000:]}"
        )
    return done.stdout


def build_wheels(folder: Path) -> tuple[Path, ...]:
    """The wheels of uwserver and its client, built by the Python that runs this."""
    for project in PROJECTS.values():
        run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, project, cwd=folder)
    return tuple(next(folder.glob(f"{name}-*.whl")) for name in PROJECTS)


def cache() -> Path:
    """Where environments with the dependencies are kept: outside of any checkout."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path("~/.cache").expanduser()) / "uwserver" / "pythons"


def dependencies(version: str, python: Path, wheels: tuple[Path, ...]) -> Path:
    """Folder with what uwserver and these tests need for one Python; made if there is none for what is needed now."""
    needed = hashlib.sha256(f"{python} {EXTRAS} {TESTING}".encode())
    for project in PROJECTS.values():
        needed.update((project / "pyproject.toml").read_bytes())
    folder = cache() / f"{version}-{needed.hexdigest()[:12]}"
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        # Of two that make it at once, the first to end has made it; nobody sees half of one.
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f"{version}-part-") as work:
            part = Path(work) / "env"
            run(python, "-m", "venv", part, cwd=folder.parent)
            pip = (part / "bin" / "python", "-m", "pip", "--disable-pip-version-check")
            server, *others = wheels
            run(
                *pip, "install", "--quiet", f"uwserver[{EXTRAS}] @ {server.as_uri()}", *others, *TESTING,
                cwd=folder.parent,
            )  # fmt: skip
            run(*pip, "uninstall", "--quiet", "--yes", *PROJECTS, cwd=folder.parent)
            if not folder.is_dir():
                part.rename(folder)
    folder.touch()
    made = [path for path in folder.parent.glob(f"{version}-*") if "part" not in path.name]
    for old in sorted(made, key=lambda path: path.stat().st_mtime)[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return folder / "lib" / f"python{version}" / "site-packages"


def environment(version: str, python: Path, wheels: tuple[Path, ...], home: Path) -> None:
    """A fresh environment with the wheels, which borrows what they depend on."""
    borrowed = dependencies(version, python, wheels)
    run(python, "-m", "venv", "--without-pip", home, cwd=ROOT)
    own = home / "lib" / f"python{version}" / "site-packages"
    (own / "dependencies.pth").write_text(BORROW.format(str(borrowed)))
    run(
        home / "bin" / "python", "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-deps", "--no-index",
        "--ignore-installed", *wheels, cwd=ROOT,
    )  # fmt: skip


def try_one(version: str, python: Path, wheels: tuple[Path, ...], work: Path) -> None:
    """Everything with one Python. Raises Failed."""
    home = work / version
    inside = home / "bin" / "python"
    server: tuple[str | Path, ...] = (home / "bin" / "uwserver",)
    freerun = ("--port", "0", "--mode", "freerun", "--until")
    tests = work / f"run_tests_{version}.py"
    tests.write_text(RUN_TESTS)
    parts: tuple[tuple[str, tuple[tuple[str | Path, ...], ...]], ...] = (
        ("doctor", ((*server, "doctor"),)),
        ("check", tuple((*server, "check", name) for name in ("bluerov2_pool", *SOLID))),
        ("default scenario", ((*server, "run", *freerun, "0.5"),)),
        ("solid scenarios", tuple((*server, "run", name, *freerun, "0.2") for name in SOLID)),
        ("codecs and contacts", ((inside, tests, ROOT, *TESTS),)),
    )
    with timed(version, "environment"):
        environment(version, python, wheels, home)
    for name, commands in parts:
        with timed(version, name):
            for command in commands:
                run(*command, cwd=work)


class timed:  # read as a statement
    """Prints how long a part took."""

    def __init__(self, version: str, part: str) -> None:
        self._label, self._begin = f"python {version}: {part}", 0.0

    def __enter__(self) -> None:
        self._begin = time.monotonic()

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        outcome = "ok" if kind is None else "FAILED"
        print(f"{self._label}: {outcome}, {time.monotonic() - self._begin:.0f} s", flush=True)


def _processor_s() -> float:
    """Processor time of all commands that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(versions: tuple[str, ...]) -> int:
    """Try all versions, as many at a time as there are cores; returns 1 if one failed."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        with timed(f"{sys.version_info[0]}.{sys.version_info[1]}", "wheels"):
            wheels = build_wheels(work)

        def succeeds(version: str) -> bool:
            python = interpreter(version)
            if python is None:
                print(f"python {version}: skipped, neither below `pyenv root` nor on the PATH", flush=True)
                return True
            try:
                with timed(version, "all"):
                    try_one(version, python, wheels, work)
            except (Failed, subprocess.TimeoutExpired) as error:
                print(error, file=sys.stderr, flush=True)
                return False
            return True

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            done = list(pool.map(succeeds, versions))
        print(f"{_processor_s():.0f} s of processors", flush=True)
    return 0 if all(done) else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("versions", nargs="*", default=VERSIONS, help=f"default: {' '.join(VERSIONS)}")
    sys.exit(main(tuple(parser.parse_args().versions)))
