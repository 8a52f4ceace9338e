"""Processes of a benchmark, and those of others."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from uwserver_bench import processes
from uwserver_bench.processes import Bystanders, carry_out


def test_each_task_has_its_result_and_one_that_fails_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    def double(task):  # type: ignore[no-untyped-def]
        if task["n"] < 0:
            raise ValueError("less than nothing")
        return {"doubled": 2 * task["n"]}

    lines = [json.dumps({"task": "double", "n": n}) for n in (3, -1, 4)]
    carry_out({"double": double}, "load", lines=lines)
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert answers == [{"doubled": 6}, {"failed": "load task double: less than nothing"}, {"doubled": 8}]


def test_what_is_no_failure_of_a_task_ends_the_process() -> None:
    with pytest.raises(ZeroDivisionError):
        carry_out({"divide": lambda task: {"one": 1 // task["by"]}}, "load", lines=['{"task": "divide", "by": 0}'])


SPIN = "import time; end = time.process_time() + 0.5\nwhile time.process_time() < end: pass"


@pytest.mark.skipif(not Path("/proc/stat").exists(), reason="no /proc here")
def test_work_of_another_process_counts() -> None:
    before = processes._others_s(os.getpid())
    subprocess.run([sys.executable, "-c", SPIN], check=True)
    after = processes._others_s(os.getpid())
    assert before is not None
    assert after is not None
    assert after - before >= 0.4


def test_own_work_is_taken_off(monkeypatch: pytest.MonkeyPatch) -> None:
    hertz = os.sysconf("SC_CLK_TCK")
    ticks = {"all": 1000 * hertz, "own": 0}

    def read(path: Path, *_: object, **__: object) -> str:
        if str(path) == "/proc/stat":
            return f"cpu  {ticks['all']} 0 0 5 5 0 0 0 0 0\n"
        return f"7 (a name) with) S 1 1 1 0 -1 0 0 0 0 0 {ticks['own']} 0 0 0 20 0"

    monkeypatch.setattr(Path, "read_text", read)
    monkeypatch.setattr(processes.SystemTime, "now_ns", lambda self: ticks["all"] * 1_000_000_000 // hertz)
    bystanders = Bystanders(7)
    ticks["all"] += 10 * hertz
    ticks["own"] += 4 * hertz
    assert bystanders.cores() == pytest.approx(0.6)


def test_a_system_that_does_not_tell_gives_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(path: Path, *_: object, **__: object) -> str:
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_text", gone)
    assert Bystanders(1).cores() is None
