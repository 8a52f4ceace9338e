"""The arrays by which threads share loops (`sharing`) and the interpreter (`giving_way`): what stands where; and how they sleep on this machine."""

from __future__ import annotations

import platform
import sys
from typing import Any

JOB, STOP, CLAIM, DONE, WAITING, FAILED, ASLEEP = 0, 1, 8, 16, 17, 18, 24
CODE, DATA, COUNT, CHUNK, THREADS, SPIN = 32, 33, 34, 35, 40, 41
"""Places in the array of a team, on cache lines by who writes them: number of the loop that is shared, and whether the threads shall end; the
ranges of it that nobody has begun; how many the others have done, whether somebody sleeps until they are, and whether one failed; how many
threads sleep; code and arguments of the loop, its rows and those of a range; how many threads share, and how often they turn round before they
sleep."""

SIZE = 48

ASKED, WATCHED, CALLED, HEARD, AWAKE = range(5)
GIVEN, RUNS, LATE, WAITED, ANSWERED = range(8, 13)
WAY_SIZE = 16
"""The same of a right of way: how often the loop has come or gone, odd while it asks for the interpreter or has it; what it waits for, as a
``struct pollfd``; how often somebody has called whoever steps the world, for how many of these calls the loop has stayed awake to hear the answer,
and whether it is awake for one now; for which of its comings the loop was given the interpreter; whether somebody runs who gives it; which time it
kept it for so long that nobody waits any more; for how many turns the world has waited for it since somebody asked; and whether there is an answer
for who is awake."""

_MACHINE = platform.machine() if sys.platform == "linux" else ""
FUTEX = {"x86_64": 202, "AMD64": 202, "aarch64": 98}.get(_MACHINE, 0)
"""Number of the system call; 0 where a thread could not sleep in compiled code."""
_X86: tuple[Any, ...] = ("llvm.x86.sse2.pause",)
PAUSE = {"x86_64": _X86, "AMD64": _X86, "aarch64": ("llvm.aarch64.hint", 1)}.get(_MACHINE, ())
"""What LLVM calls the instruction of a loop that waits, and its arguments."""
