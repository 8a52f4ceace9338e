"""Child processes of a command, none of which outlives it."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator, Sequence
from typing import Any

PATIENCE_S = 20.0
"""Wall time that a process gets to end after it was told to."""


@contextlib.contextmanager
def child(command: Sequence[str], patience_s: float = PATIENCE_S, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Start a process, and end it however the block ends.

    The process is in a session of its own, so Ctrl-C does not reach it: the parent ends it.

    Args:
        command: program and arguments.
        patience_s: wall time after which the process is killed if SIGTERM has not ended it.
        options: for `subprocess.Popen`.
    """
    with subprocess.Popen(command, start_new_session=True, **options) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(patience_s)
            finally:
                # Also when Ctrl-C interrupts the wait. It does nothing to a process that has ended.
                process.kill()
