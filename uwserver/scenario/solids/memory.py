"""Checks that the triangles of a scenario fit into memory, before they are made: the engines end the process if they get no memory."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from uwserver.physics.geometry.shapes import BadSolid

TRIANGLE_BYTES = 800
"""Bytes of one triangle while it is loaded, measured with a mesh file of a million triangles. Those of a seabed take half as much."""
RESERVE_BYTES = 300_000_000
"""Memory for kernels and everything else."""
FEW_TRIANGLES = 100_000
"""Up to this number no check is made."""
_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def check_memory(name: str, triangles: int) -> None:
    """Check that triangles fit into the free memory.

    Args:
        name: name of the file, or of what is loaded.
        triangles: number that is to be loaded.

    Raises:
        BadSolid: they do not fit; the text says how much memory is needed.
    """
    if triangles <= FEW_TRIANGLES:
        return
    needed, free = triangles * TRIANGLE_BYTES + RESERVE_BYTES, free_bytes()
    if free is not None and needed > free:
        text = f"{triangles} triangles, which need {needed / 1e9:.1f} GB of memory, but {max(free, 0) / 1e9:.1f} GB are free"
        raise BadSolid(f'"{name}" has {text}: use a part of it, thin it out, or allow more memory')


def free_bytes() -> int | None:
    """Return the memory that this process may still take, by the limits of machine, address space and container; None if none is known."""
    found = [_of_machine(), _of_limit(), *(_of_group(Path(most), Path(used)) for most, used in _GROUPS)]
    return min((free for free in found if free is not None), default=None)


def _of_machine() -> int | None:
    with suppress(OSError, ValueError, LookupError):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        amounts = {line.split(":")[0]: int(line.split()[1]) for line in lines if line.endswith(" kB")}
        return 1024 * (amounts["MemAvailable"] + amounts.get("SwapFree", 0))
    return None


def _of_limit() -> int | None:
    with suppress(ImportError, OSError, ValueError):
        import resource  # not on Windows

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
            return most - pages * os.sysconf("SC_PAGE_SIZE")
    return None


def _of_group(most: Path, used: Path) -> int | None:
    with suppress(OSError, ValueError):
        return int(most.read_text(encoding="ascii")) - int(used.read_text(encoding="ascii"))
    return None
