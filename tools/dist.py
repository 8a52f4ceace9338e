"""Builds and checks what is published: source distributions and wheels of uwserver, uwclient and uwserver-bench.

    python tools/dist.py                             into dist/, with kernels for each CPython of pyproject.toml that this machine has
    python tools/dist.py --python python3.11         with kernels for this one only
    python tools/dist.py --release --bars            all CPythons must be there, CHANGELOG.md dated, and the bars of tools/first_minute.py met

Wheels are built from the source distributions. Of uwserver there is a pure wheel, and for each Python one with the kernels compiled for x86-64 and
one for aarch64 (tools/kernel_wheel.py). Every file is looked at by twine; then a fresh environment takes the wheels with all dependencies and uses
them, without compiling anything. Stops at the first fault with status 1.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import kernel_wheel
import other_pythons
import wheels
from wheels import ROOT, Fault

import uwserver


def check_changelog(text: str, version: str, release: bool) -> None:
    """CHANGELOG.md has a section of this version with something in it: for a release one with a date, before that one that says Unreleased.

    Raises:
        Fault: and what to write.
    """
    dated = rf"^## \[{re.escape(version)}\] (?:- )?\d{{4}}-\d\d-\d\d$"
    open_ = rf"^## \[Unreleased\](?: {re.escape(version)})?$"
    found = re.search(dated if release else f"{dated}|{open_}", text, re.MULTILINE)
    if found is None:
        raise Fault(f'CHANGELOG.md has no section "## [{version}] - YYYY-MM-DD"; it is written before a release')
    section = text[found.end() :].partition("\n## ")[0]
    if not re.search(r"^- ", section, re.MULTILINE):
        raise Fault(f'CHANGELOG.md: the section "{found[0]}" says nothing')


def remove_old(out: Path) -> None:
    """Take away what an earlier build left, so that nothing else is published with this one."""
    for path in out.iterdir():
        if re.match(r"uw(?:server|client|server_bench)-.*\.(?:whl|tar\.gz)$", path.name):
            path.unlink()


def build(out: Path, pythons: Sequence[str]) -> list[Path]:
    """All files, in a folder.

    Raises:
        Fault: a file is missing in a wheel.
        kernel_wheel.NotBuilt: kernels could not be compiled.
    """
    pure = wheels.build_all(out)
    for python in pythons:
        for wheel in kernel_wheel.build(pure["uwserver"], python, out):
            print(f"{wheel.name}: {wheel.stat().st_size // 1024} KiB, kernels included", flush=True)
    return sorted(path for path in out.iterdir() if path.name.endswith((".whl", ".tar.gz")))


def interpreters(pyproject: str, release: bool) -> list[str]:
    """The CPythons of the classifiers of pyproject.toml, as far as they are on this machine.

    Raises:
        Fault: one is missing, and it is for a release.
    """
    found: list[str] = []
    for version in re.findall(r'"Programming Language :: Python :: (3\.\d+)"', pyproject):
        python = other_pythons.interpreter(version)
        if python is not None:
            found.append(str(python))
        elif release:
            raise Fault(f"a release has wheels for Python {version}: neither below `pyenv root` nor on the PATH")
        else:
            print(f"no wheel with kernels for Python {version}: it is not on this machine", flush=True)
    return found


def check(out: Path, files: Sequence[Path], bars: bool) -> None:
    """What the package index would say, a fresh environment, and the first minute.

    Raises:
        Fault: a check failed; it has said why.
    """
    tools = Path(__file__).parent
    commands = (
        ("-m", "twine", "check", "--strict", *files),
        (tools / "wheel_smoke.py", "--dependencies", "--dist", out),
        (tools / "first_minute.py", "--dist", out, *(["--check"] if bars else [])),
    )
    for command in commands:
        done = subprocess.run([sys.executable, *map(str, command)], check=False, env=os.environ)
        if done.returncode != 0:
            raise Fault(f"{command[0]} {command[1]} ended with {done.returncode}")


def main() -> int:
    """Build, check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--python", action="append", help="an interpreter that gets a wheel with kernels; again for more"
    )
    parser.add_argument("--pure", action="store_true", help="no wheel with kernels")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder")
    parser.add_argument("--release", action="store_true", help="the section of CHANGELOG.md must have its date")
    parser.add_argument("--bars", action="store_true", help="the first minute must be one: for an idle machine")
    options = parser.parse_args()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    try:
        changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
        check_changelog(changelog, uwserver.__version__, options.release)
        remove_old(out)
        pyproject = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
        pythons = options.python or interpreters(pyproject, options.release)
        files = build(out, [] if options.pure else pythons)
        check(out, files, options.bars)
    except (Fault, kernel_wheel.NotBuilt) as fault:
        print(f"dist: {fault}", file=sys.stderr)
        return 1
    print(f"{out}: {len(files)} files, ready to publish (docs/how-to/release.md)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
