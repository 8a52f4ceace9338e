"""The places of the numbers in the array of a team, by which threads share loops (`sharing`), and how threads sleep on this machine."""

from __future__ import annotations

import platform
import sys
from typing import Any

from uwserver.physics.kernel.plain import IS_PLAIN

JOB, STOP, CLAIM, DONE, WAITING, FAILED, ASLEEP = 0, 1, 8, 16, 17, 18, 24
CODE, DATA, COUNT, CHUNK, THREADS, SPIN = 32, 33, 34, 35, 40, 41
"""Places in the array of a team, on separate cache lines for separate writers: the number of the loop that is shared, and whether the threads
shall end; the ranges that no thread has begun; how many ranges the other threads have done, whether the caller sleeps until they are done, and
whether one failed; how many threads sleep; code and arguments of the loop, its number of rows, and the rows of a range; how many threads share
loops, and how often they spin before they sleep."""

SIZE = 48

_MACHINE = platform.machine() if sys.platform == "linux" and not IS_PLAIN else ""
FUTEX = {"x86_64": 202, "AMD64": 202, "aarch64": 98}.get(_MACHINE, 0)
"""Number of the futex system call; 0 if threads cannot sleep in compiled code here."""
_X86: tuple[Any, ...] = ("llvm.x86.sse2.pause",)
PAUSE = {"x86_64": _X86, "AMD64": _X86, "aarch64": ("llvm.aarch64.hint", 1)}.get(_MACHINE, ())
"""LLVM's name of the instruction for a loop that waits, and its arguments."""
