"""Tells a person at a terminal or a notebook how far a long step is."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from uwserver.ports.sample_batch import Samples
from uwserver.simulation.clock import SystemTime
from uwserver.units import NANOSECONDS
from uwserver.world import Diverged

SWITCH = "UWSERVER_PROGRESS"
"""Environment variable; 0 turns it off."""
FIRST_S = 1.0
"""Wall time of a step before anything is shown."""
EVERY_S = 0.25
"""Wall time between two lines."""
_PIECE_S = 0.1
_FEW = 256
"""Ticks that are made in one call at first. A shorter step is never shown."""


def with_progress(step: Callable[[int], Samples], n: int, dt_s: float) -> Samples:
    """Run n ticks, and show how far they are, on one line of standard error that is cleared at the end.

    Nothing is shown in the first second, in output that is no terminal and no notebook, and with `SWITCH` = 0. The ticks are the same.

    Args:
        step: runs ticks.
        n: how many.
        dt_s: length of a tick, s.
    """
    if type(n) is not int or n <= _FEW or not is_watched():
        return step(n)
    return _shown(step, n, dt_s)


def is_watched() -> bool:
    """Return whether a person looks at standard error, and wants to know."""
    if os.environ.get(SWITCH) == "0":
        return False
    return (sys.stdout.isatty() and sys.stderr.isatty()) or is_notebook()


def is_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell is not None and hasattr(shell, "kernel")


def _shown(step: Callable[[int], Samples], n: int, dt_s: float) -> Samples:
    now, width, samples = SystemTime().now_ns, 0, Samples()
    began = at = now()
    told, done, piece = began + int((FIRST_S - EVERY_S) * NANOSECONDS), 0, _FEW
    try:
        while done < n:
            made = min(piece, n - done)
            try:
                samples.join(step(made))
            except Diverged as diverged:
                samples.join(diverged.samples)
                diverged.samples = samples
                raise
            done += made
            before, at = at, now()
            piece = max(1, min(2 * piece, int(piece * _PIECE_S * NANOSECONDS / max(at - before, 1))))
            if at - told > EVERY_S * NANOSECONDS and done < n:
                told = at
                line = _line(done, n, dt_s, (at - began) / NANOSECONDS)
                sys.stderr.write("\r" + line.ljust(width))
                sys.stderr.flush()
                width = len(line)
    finally:
        if width:
            sys.stderr.write("\r" + " " * width + "\r")
            sys.stderr.flush()
    return samples


def _line(done: int, n: int, dt_s: float, wall_s: float) -> str:
    left_s = wall_s * (n - done) / done
    speed = done * dt_s / wall_s
    return f"{100 * done // n:3d} %: {done * dt_s:.1f} of {n * dt_s:.1f} s, {speed:.3g} times real time, about {left_s:.0f} s left"
