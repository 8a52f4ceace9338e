"""A process that a command started ends with it, however that ends."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from uwserver.cli.browser.child import child

WAITS = [sys.executable, "-c", "import sys; print('ready', flush=True); sys.stdin.read()"]
DEAF = [
    sys.executable,
    "-c",
    "import signal, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('ready', flush=True); time.sleep(600)",
]
PIPES = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}


@pytest.mark.parametrize("fault", [ValueError, KeyboardInterrupt, SystemExit])
def test_it_ends_with_a_block_that_fails(fault: type[BaseException]) -> None:
    seen: list[subprocess.Popen[bytes]] = []

    def run() -> None:
        with child(WAITS, **PIPES) as process:
            seen.append(process)
            assert process.stdout.readline() == b"ready\n"
            raise fault

    with pytest.raises(fault):
        run()
    (process,) = seen
    assert process.returncode == -signal.SIGTERM


def test_one_that_does_not_listen_is_killed() -> None:
    with child(DEAF, patience_s=0.2, **PIPES) as process:
        assert process.stdout.readline() == b"ready\n"
    assert process.returncode == -signal.SIGKILL


def test_one_that_has_ended_already_keeps_its_status() -> None:
    with child([sys.executable, "-c", "raise SystemExit(3)"]) as process:
        process.wait()
    assert process.returncode == 3
