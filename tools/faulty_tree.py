"""A clone of the checkout that holds one fault at a time, and runs tests: what `faults` works with."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import msgspec

ROOT = Path(__file__).parents[1]
SOURCE_ROOTS = (".", "adapters", "scenarios", "bench", "clients/python")
PACKAGES = ("uwserver", "uwserver_adapters", "uwserver_scenarios", "uwserver_bench", "uwclient")
HANGS_S = 900.0
"""Wall time without a further line of pytest after which a test hangs; kernels of a fault in physics compile meanwhile."""
_LOOK_S = 2.0
MOST_DOUBTS = 3
"""Tests that fail with a fault, but not alone, before it counts as survived."""
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+\.py(?:::.+?)?)(?: - .*)?$", re.MULTILINE)
_BEGUN = re.compile(r"^(\S+\.py::\S+)", re.MULTILINE)


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One fault.

    Attributes:
        file: below the checkout, with `old` in it exactly once.
        new: what takes its place.
        wrong: a sentence that says what is wrong then.
    """

    name: str
    file: str
    old: str
    new: str
    wrong: str

    @property
    def key(self) -> str:
        """Changes with what the fault does."""
        return hashlib.sha256("\0".join((self.file, self.old, self.new)).encode()).hexdigest()[:12]


_SECOND_NS = 1_000_000_000


class Trial(msgspec.Struct, frozen=True, omit_defaults=True):
    """What tests have shown of a fault.

    Attributes:
        by: the first test that found it.
        seconds: wall time.
        commit: commit of the tests.
        doubts: tests that failed with the fault once, and not again.
    """

    result: Literal["found", "survived"]
    by: str = ""
    seconds: int = 0
    commit: str = ""
    doubts: tuple[str, ...] = ()


class Tree:
    """Sources and tests.

    Attributes:
        root: where they are.
        commit: commit of the tests.
        broken, sound: tests of which it is known that they fail, or pass, without any fault. Grow.
    """

    def __init__(self, root: Path, python: Path, cache: Path, broken: list[str], sound: list[str]) -> None:
        """Take a folder as it is.

        Args:
            root: where the folder is.
            python: runs the tests.
            cache: folder for compiled kernels.
            broken, sound: what is known already.
        """
        self.root, self.commit, self.broken, self.sound = root, "", broken, sound
        self._python, self._cache, self._log = python, cache, root.with_suffix(".log")
        self._environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        self._environment |= {
            "PYTHONPATH": os.pathsep.join(str(root / each) for each in SOURCE_ROOTS),
            "NUMBA_CACHE_DIR": str(cache),
        }

    def check(self) -> None:
        """End unless its own sources are imported."""
        code = f"import {', '.join(PACKAGES)}; print(*(p.__file__ for p in ({', '.join(PACKAGES)})), sep='\\n')"
        for place in run(str(self._python), "-c", code, cwd=self.root, env=self._environment).splitlines():
            if not Path(place).is_relative_to(self.root):
                raise SystemExit(f"{place} is imported instead of what is in {self.root}")

    @contextmanager
    def holding(self, fault: Fault) -> Iterator[None]:
        """Have a fault in it; kernels that were compiled of it are removed afterwards."""
        path = self.root / fault.file
        text, times = path.read_text(encoding="utf-8"), path.stat()
        if text.count(fault.old) != 1:
            raise SystemExit(f"{fault.name}: its text stands {text.count(fault.old)} times in {path}")
        caches = set(self._cache.glob("kernels-*"))
        try:
            path.write_text(text.replace(fault.old, fault.new), encoding="utf-8")
            os.utime(
                path, ns=(times.st_atime_ns, times.st_mtime_ns + 10 * _SECOND_NS)
            )  # byte code goes by whole seconds and sizes
            yield
        finally:
            path.write_text(text, encoding="utf-8")
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            for folder in set(self._cache.glob("kernels-*")) - caches:
                shutil.rmtree(folder, ignore_errors=True)

    def compile(self) -> None:
        """Have all kernels ready, so that no server of a test waits for them; if they do not run, tests will show it."""
        command = [str(self._python), "-m", "uwserver.world.warm"]
        subprocess.run(command, cwd=self.root, env=self._environment, capture_output=True, check=False)

    def first_failure(self, tests: Sequence[str], *options: str) -> str:
        """The first test that fails or hangs, "" if none does; a file in which no test could begin counts as one."""
        left_out = [f"--{'deselect' if '::' in test else 'ignore'}={test}" for test in self.broken]
        command = [str(self._python), "-m", "pytest", "-x", "-v", "--tb=no", "-rfE", "-p", "no:cacheprovider"]
        with self._log.open("w") as log:
            running = subprocess.Popen(
                [*command, "-m", "not slow", *options, *left_out, *tests], cwd=self.root, env=self._environment,
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
            try:
                code = self._end_of(running)
            finally:
                if running.poll() is None:
                    os.killpg(running.pid, signal.SIGKILL)
                    running.wait()
        text = self._log.read_text(encoding="utf-8", errors="replace")
        if code in (0, 5):  # 5: no test is there
            return ""
        failed, begun = _FAILED.search(text), _BEGUN.findall(text)
        if code is None and begun:
            return str(begun[-1])
        if failed is None:
            raise SystemExit(f"pytest ended with {code}:\n{text[-3000:]}")
        return failed[1]

    def _end_of(self, running: subprocess.Popen[bytes]) -> int | None:
        """Status of pytest; None where it hangs."""
        size, since = -1, time.monotonic()
        while True:
            try:
                return running.wait(_LOOK_S)
            except subprocess.TimeoutExpired:
                if size != (size := self._log.stat().st_size):
                    since = time.monotonic()
                elif time.monotonic() - since > HANGS_S:
                    return None

    def is_sound(self, test: str) -> bool:
        """Whether a test passes without any fault; to be asked while there is none."""
        if test not in self.sound:
            (self.broken if self._fails_alone(test) else self.sound).append(test)
        return test in self.sound

    def _fails_alone(self, test: str) -> bool:
        return bool(self.first_failure([test], *(() if "::" in test else ("--collect-only",))))

    def tried(self, fault: Fault, tests: Sequence[str], *options: str, warm: bool = False) -> Trial:
        """Whether tests find a fault.

        Args:
            fault: to be put in.
            tests, options: for pytest.
            warm: compile kernels of physics first.
        """
        begin, doubts = time.monotonic(), list[str]()
        while True:
            with self.holding(fault):
                if warm and fault.file.startswith("uwserver/physics/"):
                    self.compile()
                by = self.first_failure(tests, *options, *(f"--deselect={test}" for test in doubts))
                again = bool(by) and self._fails_alone(by)
            if by and not self.is_sound(by):
                continue
            if by and not again and len(doubts) < MOST_DOUBTS:
                doubts.append(by)
                continue
            seconds = round(time.monotonic() - begin)
            return Trial("found" if again else "survived", by if again else "", seconds, self.commit, tuple(doubts))


def tree_of(root: Path, python: Path, cache: Path, broken: list[str], sound: list[str], tests: Path | None) -> Tree:
    """A clone of the checkout, made now or taken as an earlier call left it.

    Args:
        root: where it is, or is to be.
        python, cache, broken, sound: as of `Tree`.
        tests: folder of other tests than those of its commit.
    """
    if not root.is_dir():
        run("git", "clone", "--quiet", str(ROOT), str(root), cwd=ROOT)
    run("git", "checkout", "--quiet", "--force", "HEAD", "--", ".", cwd=root)
    if tests is not None:
        shutil.rmtree(root / "tests")
        shutil.copytree(tests, root / "tests", ignore=shutil.ignore_patterns("__pycache__"))
    for kernels in (each for each in user_cache().glob("kernels-*") if not (cache / each.name).is_dir()):
        shutil.copytree(kernels, cache / kernels.name)  # those of the code without a fault need not be compiled again
    tree = Tree(root, python, cache, broken, sound)
    tree.commit = commit_of(tests or root)
    tree.check()
    return tree


def user_cache() -> Path:
    """Where a user's compiled kernels are."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path("~/.cache").expanduser()) / "uwserver"


def update(root: Path) -> None:
    """Move a clone to the commit of the checkout."""
    commit = run("git", "rev-parse", "HEAD", cwd=ROOT).strip()
    run("git", "fetch", "--quiet", str(ROOT), commit, cwd=root)
    run("git", "checkout", "--quiet", "--force", "--detach", commit, cwd=root)


def commit_of(folder: Path) -> str:
    """Of the repository in which a folder is."""
    return run("git", "rev-parse", "--short", "HEAD", cwd=folder).strip()


def run(*command: str, cwd: Path, env: dict[str, str] | None = None) -> str:
    """What a command prints that must succeed."""
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(
            f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
        )
    return done.stdout
