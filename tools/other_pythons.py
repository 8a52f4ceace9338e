"""Tries uwserver with the other CPythons of this machine; exits with 1 if anything failed there.

Each gets an environment under .venv/pythons with the wheel and what running needs, and there: doctor, the default scenario, the codecs, and
the contacts with the engine that this Python has. Versions that are not installed are skipped, with a line that says so. Kernels compile once
for each Python, into the user's cache. The time of each part is printed.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
VERSIONS = ("3.10", "3.12", "3.13")
EXTRAS = "solid,zenoh,mavlink"
TESTING = ("pytest>=8.2", "hypothesis>=6.100", "msgpack>=1.0", "jsonschema>=4.20")
TESTS = (
    "tests/unit/ports",
    "tests/unit/adapter",
    "tests/unit/adapters/native",
    "tests/unit/physics/collision/test_engine.py",
    "tests/unit/physics/collision/test_narrow_phase.py",
    "tests/unit/physics/rays/test_tree.py",
    "tests/physics/test_contact.py",
)
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


def build_wheel(folder: Path) -> Path:
    """The wheel of uwserver, built by the Python that runs this."""
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
    (wheel,) = folder.glob("uwserver-*.whl")
    return wheel


def prepare(python: Path, wheel: Path, home: Path) -> None:
    """An environment with the wheel and its dependencies; these only if what is needed has changed."""
    inside = home / "bin" / "python"
    stamp, needed = (
        home / "needed",
        hashlib.sha256((ROOT / "pyproject.toml").read_bytes() + str(python).encode()).hexdigest(),
    )
    pip = (inside, "-m", "pip", "--disable-pip-version-check", "install", "--quiet")
    if not stamp.exists() or stamp.read_text() != needed:
        run(python, "-m", "venv", "--clear", home, cwd=ROOT)
        run(*pip, f"uwserver[{EXTRAS}] @ {wheel.as_uri()}", *TESTING, cwd=ROOT)
        stamp.write_text(needed)
    run(*pip, "--no-deps", "--force-reinstall", wheel, cwd=ROOT)


def try_one(version: str, python: Path, wheel: Path, work: Path) -> None:
    """Everything with one Python. Raises Failed."""
    home = ROOT / ".venv" / "pythons" / version
    server, inside = home / "bin" / "uwserver", home / "bin" / "python"
    parts: tuple[tuple[str, tuple[tuple[str | Path, ...], ...]], ...] = (
        ("doctor", ((server, "doctor"),)),
        ("check", tuple((server, "check", name) for name in ("bluerov2_pool", "slope"))),
        ("default scenario", ((server, "run", "--port", "0", "--until", "0.5", "--mode", "freerun"),)),
        ("codecs and contacts", ((inside, "-m", "pytest", "-q", "-p", "no:cacheprovider", *TESTS),)),
    )
    with timed(version, "environment"):
        prepare(python, wheel, home)
    for name, commands in parts:
        with timed(version, name):
            for command in commands:
                run(*command, cwd=ROOT if "pytest" in command else work)


class timed:  # read as a statement
    """Prints how long a part took."""

    def __init__(self, version: str, part: str) -> None:
        self._label, self._begin = f"python {version}: {part}", 0.0

    def __enter__(self) -> None:
        self._begin = time.monotonic()

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        print(
            f"{self._label}: {'ok' if kind is None else 'FAILED'}, {time.monotonic() - self._begin:.0f} s", flush=True
        )


def main(versions: tuple[str, ...]) -> int:
    """Try all versions; returns 1 if one failed."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        with timed(f"{sys.version_info[0]}.{sys.version_info[1]}", "wheel"):
            wheel = build_wheel(work)
        for version in versions:
            python = interpreter(version)
            if python is None:
                print(f"python {version}: skipped, neither below `pyenv root` nor on the PATH", flush=True)
                continue
            try:
                try_one(version, python, wheel, work)
            except (Failed, subprocess.TimeoutExpired) as error:
                print(error, file=sys.stderr, flush=True)
                failed = 1
    return failed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("versions", nargs="*", default=VERSIONS, help=f"default: {' '.join(VERSIONS)}")
    sys.exit(main(tuple(parser.parse_args().versions)))
