"""Processes that a command starts for itself: none outlives it."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator, Sequence
from typing import Any

PATIENCE_S = 20.0
"""Wall time in which a process that is told to end may do so."""


@contextlib.contextmanager
def child(command: Sequence[str], patience_s: float = PATIENCE_S, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Start a process, and end it however the block ends.

    It hears no Ctrl-C of its own: who started it does, and ends it.

    Args:
        command: program and arguments.
        patience_s: after so long it is killed.
        options: for `subprocess.Popen`.
    """
    with subprocess.Popen(command, start_new_session=True, **options) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(patience_s)
            except subprocess.TimeoutExpired:
                pass
            finally:
                process.kill()  # also when this wait was interrupted; nothing, where it has ended
