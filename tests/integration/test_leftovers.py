"""Nothing that a test started outlives the run, even one that is killed: see `pytest_configure` in tests/conftest.py."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PATIENCE_S = 60.0
CONFTEST = Path(__file__).parents[1] / "conftest.py"
TEST = """
import subprocess, sys, time

def test_that_starts_and_waits():
    child = subprocess.Popen([sys.executable, "-c", "import subprocess, sys, time; "
        "print(subprocess.Popen(['sleep', '600'], start_new_session=True).pid, flush=True); time.sleep(600)"],
        stdout=subprocess.PIPE, text=True, start_new_session=True)
    print(child.pid, child.stdout.readline().strip(), flush=True)
    time.sleep(600)
"""

pytestmark = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc, as Linux has it")


def lives(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text()
    return False


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_nothing_outlives_a_run_that_is_aborted(tmp_path, how):
    (tmp_path / "conftest.py").write_text(CONFTEST.read_text())
    (tmp_path / "test_waits.py").write_text(TEST)
    command = [sys.executable, "-m", "pytest", "-q", "-s", "-p", "no:cacheprovider", "test_waits.py"]
    environ = {name: value for name, value in os.environ.items() if name != "UWSERVER_TEST_RUN"}
    with subprocess.Popen(command, cwd=tmp_path, env=environ, stdout=subprocess.PIPE, text=True) as run:
        try:
            assert run.stdout is not None
            child, grandchild = map(int, next(line for line in run.stdout if line[:1].isdigit()).split())
            assert lives(child)
            assert lives(grandchild)
        finally:
            run.send_signal(how)
        run.wait(PATIENCE_S)
    end = time.monotonic() + PATIENCE_S
    while lives(child) or lives(grandchild):
        assert time.monotonic() < end, "what the test started still runs"
        time.sleep(0.05)
