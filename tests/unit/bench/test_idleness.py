"""Work of others is told apart from that of the measured process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from uwserver_bench import idleness
from uwserver_bench.idleness import Bystanders

SPIN = "import time; end = time.process_time() + 0.5\nwhile time.process_time() < end: pass"


@pytest.mark.skipif(not Path("/proc/stat").exists(), reason="no /proc here")
def test_work_of_another_process_counts() -> None:
    before = idleness._others_s(os.getpid())
    subprocess.run([sys.executable, "-c", SPIN], check=True)
    after = idleness._others_s(os.getpid())
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
    monkeypatch.setattr(idleness.SystemTime, "now_ns", lambda self: ticks["all"] * 1_000_000_000 // hertz)
    bystanders = Bystanders(7)
    ticks["all"] += 10 * hertz
    ticks["own"] += 4 * hertz
    assert bystanders.cores() == pytest.approx(0.6)


def test_a_system_that_does_not_tell_gives_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(path: Path, *_: object, **__: object) -> str:
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_text", gone)
    assert Bystanders(1).cores() is None
