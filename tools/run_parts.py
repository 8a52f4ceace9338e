"""Runs parts of `make test`, each a target of the Makefile, and says what each took: on the wall, and of the processors.

    python tools/run_parts.py lint types tests
    python tools/run_parts.py --kept build/test-all.json lint types tests slow-tests

A part that fails does not keep the others from running; the exit status is 1 then. What a part took of the processors holds for all processes that it
started and that have ended. With ``--kept`` a run that was broken off goes on where it was: what has passed since a file of the checkout was last
changed is not run again. The figures are left in ``build/tests/parts.json``, for tools/costs_of_tests.py.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
FIGURES = Path("build", "tests")
"""Below the root: `parts.json` of this tool, and of each part that runs pytest PART.xml with its results."""


class Run(NamedTuple):
    """How a part ended, and what it took in seconds."""

    part: str
    passed: bool
    wall_s: float
    cpu_s: float


def run(part: str, root: Path = ROOT) -> Run:
    """Make one target, and wait for it."""
    begin = time.monotonic()
    process = subprocess.Popen([os.environ.get("MAKE", "make"), "--no-print-directory", "--keep-going", part], cwd=root)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)  # it is waited for: Popen must not do it again
    return Run(part, process.returncode == 0, time.monotonic() - begin, used.ru_utime + used.ru_stime)


def state(root: Path = ROOT) -> str:
    """Hash of every file of the checkout that git does not ignore; empty where git does not know it."""
    command = ("git", "ls-files", "--cached", "--others", "--exclude-standard", "-z")
    listed = subprocess.run(command, cwd=root, capture_output=True, check=False)
    if listed.returncode:
        return ""
    whole = hashlib.sha256()
    for name in sorted(set(listed.stdout.split(b"\0"))):
        path = root / os.fsdecode(name)
        if path.is_file():
            whole.update(name + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()


def run_all(parts: Sequence[str], kept: Path | None, root: Path = ROOT) -> list[Run]:
    """All parts; those that `kept` says to have passed with the same files are not run again, but stand in the result."""
    of = state(root) if kept else ""
    earlier = _read(kept, of)
    runs: list[Run] = []
    for part in parts:
        if part in earlier:
            print(f"== {part}: passed before, with the same files", flush=True)
            runs.append(earlier[part])
            continue
        print(f"== {part}", flush=True)
        (root / FIGURES / f"{part}.xml").unlink(missing_ok=True)
        runs.append(run(part, root))
        if kept and of:
            passed = [list(each) for each in runs if each.passed]
            _write(kept, {"state": of, "passed": passed})
    return runs


def _read(kept: Path | None, of: str) -> dict[str, Run]:
    if kept is None or not of or not kept.is_file():
        return {}
    found = json.loads(kept.read_text(encoding="utf-8"))
    return {each[0]: Run(*each) for each in found["passed"]} if found["state"] == of else {}


def _write(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def counts(parts: Sequence[str], root: Path = ROOT) -> dict[str, int]:
    """Tests that passed, failed and were skipped, in all parts that left results of pytest."""
    found = dict.fromkeys(("tests", "failures", "errors", "skipped"), 0)
    for part in parts:
        path = root / FIGURES / f"{part}.xml"
        if path.is_file():
            for suite in ElementTree.parse(path).iter("testsuite"):
                for name in found:
                    found[name] += int(suite.get(name, "0"))
    failed = found["failures"] + found["errors"]
    return {
        "passed": max(found["tests"] - failed - found["skipped"], 0),
        "failed": failed,
        "skipped": found["skipped"],
    }


def table(runs: Sequence[Run]) -> str:
    """What each part took, and all of them."""
    rows = [
        *runs,
        Run("all", all(each.passed for each in runs), *map(sum, zip(*(each[2:] for each in runs), strict=True))),
    ]
    lines = [f"{'part':<20}{'wall s':>8}{'processor s':>13}"]
    lines += [
        f"{each.part:<20}{each.wall_s:8.0f}{each.cpu_s:13.0f}{'' if each.passed else '  FAILED'}" for each in rows
    ]
    return "\n".join(lines)


def main() -> int:
    """Exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", metavar="PART", help="a target of the Makefile")
    parser.add_argument(
        "--kept", type=Path, metavar="FILE", help="go on where the run that left this file was broken off"
    )
    options = parser.parse_args()
    runs = run_all(options.parts, options.kept)
    _write(ROOT / FIGURES / "parts.json", [each._asdict() for each in runs])
    print(table(runs))
    found = counts(options.parts)
    print(", ".join(f"{number} {name}" for name, number in found.items()), flush=True)
    return 0 if all(each.passed for each in runs) else 1


if __name__ == "__main__":
    sys.exit(main())
