"""The array by which threads share loops (`sharing`): what stands where; and how the threads sleep on this machine."""

from __future__ import annotations

import platform
import sys
from typing import Any

from uwserver.physics.kernel.plain import IS_PLAIN

JOB, STOP, CLAIM, DONE, WAITING, FAILED, ASLEEP = 0, 1, 8, 16, 17, 18, 24
CODE, DATA, COUNT, CHUNK, THREADS, SPIN = 32, 33, 34, 35, 40, 41
"""Places in the array of a team, on cache lines by who writes them: number of the loop that is shared, and whether the threads shall end; the
ranges of it that nobody has begun; how many the others have done, whether somebody sleeps until they are, and whether one failed; how many
threads sleep; code and arguments of the loop, its rows and those of a range; how many threads share, and how often they turn round before they
sleep."""

SIZE = 48

_MACHINE = platform.machine() if sys.platform == "linux" and not IS_PLAIN else ""
FUTEX = {"x86_64": 202, "AMD64": 202, "aarch64": 98}.get(_MACHINE, 0)
"""Number of the system call; 0 where a thread could not sleep in compiled code."""
_X86: tuple[Any, ...] = ("llvm.x86.sse2.pause",)
PAUSE = {"x86_64": _X86, "AMD64": _X86, "aarch64": ("llvm.aarch64.hint", 1)}.get(_MACHINE, ())
"""What LLVM calls the instruction of a loop that waits, and its arguments."""
