"""Compiling in processes: what is missing, how far it is, and that no process stays behind."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from uwserver.physics.kernel import compiled
from uwserver.physics.kernel.compiled import CacheState
from uwserver.world import builds, warm
from uwserver.world.builds import Progress


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(compiled, "cache_state", CacheState(tmp_path, ""))
    return tmp_path


def keep(folder: Path, stage: str) -> None:
    for kernel in builds.kernels_of(stage):
        (folder / f"{kernel}-00.kernel").touch()


def test_every_stage_has_its_kernels_and_its_time() -> None:
    assert builds.STAGES.keys() == warm.COMPILE.keys()
    names = [name for stage in builds.STAGES for name in builds.kernels_of(stage)]
    assert len(set(names)) == len(names) > 40


def test_a_sensor_that_is_edited_is_missing(empty: Path) -> None:
    """Its name alone does not do: the code of sensors is part of it."""
    for name in builds.kernels_of("sensors"):
        (empty / f"{name.partition('+')[0]}+0123456789ab-00.kernel").touch()
    assert builds.missing(("sensors",)) == ("sensors",)
    keep(empty, "sensors")
    assert builds.missing(("sensors",)) == ()


def test_only_what_is_asked_for_and_not_there_is_missing(empty: Path) -> None:
    assert builds.missing(("sea", "free", "fins")) == ("fins", "free", "sea")  # the longest first
    keep(empty, "fins")
    (empty / "integrator.advance-00.kernel").touch()  # one of the two of "free"
    assert builds.missing(("sea", "free", "fins")) == ("free", "sea")


def test_nothing_is_said_when_nothing_is_missing(empty: Path) -> None:
    keep(empty, "free")
    said: list[str] = []
    assert not builds.prepare(("free",), lambda text, last: said.append(text))
    assert not said


def test_parts_are_made_side_by_side_and_counted(empty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[str] = []

    def start(stages: list[str], nice: int = 0, module: str = "") -> subprocess.Popen[bytes]:
        started.extend(stages)
        return subprocess.Popen([sys.executable, "-c", ""], stdin=subprocess.PIPE)

    monkeypatch.setattr(builds, "start", start)
    said: list[tuple[str, bool]] = []
    assert builds.prepare(("free", "fins", "sea"), lambda *line: said.append(line))
    assert started == ["fins", "free", "sea"]
    assert "0 of 3 parts ready, about" in said[0][0]
    assert "3 of 3 parts ready" in said[-1][0]
    assert [last for _, last in said] == [False] * (len(said) - 1) + [True]


def test_without_a_cache_it_is_left_to_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "cache_state", CacheState(None, "not writable"))
    monkeypatch.setattr(builds, "start", lambda *_: pytest.fail("nothing could be kept"))
    said: list[str] = []
    assert builds.prepare(("free",), lambda text, last: said.append(text))
    assert "in memory" in said[0]


def test_a_process_that_has_compiled_ends_well() -> None:
    """Though it still watches its parent."""
    process = builds.start([])
    try:
        assert process.wait(60) == 0
    finally:
        builds.stop(process)


@pytest.mark.parametrize(
    ("waiting", "running", "done", "workers", "elapsed", "left"),
    [
        ((), (), (Progress(8.0, 8.0),), 2, 9.0, 0.0),
        ((), (Progress(0.0, 12.0),), (), 2, 0.0, 12.0),
        ((8.0,), (Progress(0.0, 12.0),), (), 1, 0.0, 20.0),
        ((), (Progress(6.0, 12.0),), (), 1, 6.0, 6.0),
        # Another program takes half of the processor: what is left takes twice as long, whatever the wall clock says.
        ((), (Progress(6.0, 12.0),), (), 1, 12.0, 12.0),
        # A slower machine, as the stage that is done shows.
        ((4.0,), (), (Progress(16.0, 8.0),), 1, 16.0, 8.0),
        # Longer than expected: never "1 s" for minutes.
        ((), (Progress(60.0, 12.0),), (), 1, 180.0, 18.0),
        # A system that does not tell processor times.
        ((), (Progress(0.0, 12.0),), (Progress(0.0, 8.0),), 2, 30.0, 12.0),
    ],
)  # fmt: skip
def test_the_time_that_is_left(waiting, running, done, workers, elapsed, left) -> None:
    assert builds.time_left(waiting, running, done, workers, elapsed) == pytest.approx(left)


def test_the_processor_time_of_a_process() -> None:
    before = builds.processor_time(os.getpid())
    sum(range(3_000_000))
    if before:  # Linux
        assert builds.processor_time(os.getpid()) > before
    assert builds.processor_time(2**30) == 0.0


def test_a_process_ends_with_who_started_it_and_when_it_is_stopped() -> None:
    code = "from uwserver.world.builds import watch_parent; import time; watch_parent(); print(1, flush=True); time.sleep(60)"
    pipe = subprocess.PIPE
    orphan, stopped = (subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe) for _ in range(2))
    for process in (orphan, stopped):
        assert process.stdout is not None
        process.stdout.readline()
    assert orphan.stdin is not None
    orphan.stdin.close()
    assert orphan.wait(30) == 1
    builds.stop(stopped)
    assert stopped.returncode == -9
    for process in (orphan, stopped):
        process.stdout.close()  # type: ignore[union-attr]


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("stream", "expected"), [(io.StringIO(), "one...\n"), (_Terminal(), "\rone...\rtwo   \n")])
def test_a_terminal_gets_a_line_that_moves_and_a_log_one_line(
    stream: io.StringIO, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    tell = builds.progress()
    tell("one...", False)
    tell("two", True)
    assert stream.getvalue() == expected
