"""Compiles kernels with numba's public interface only: a fallback for versions of numba that `numba_private` does not fit.

The environment variable UWSERVER_KERNELS=plain chooses it. The results are the same. The first start takes about four times as long, the cache is
larger, and each world is stepped by one thread, because numba does not cache code that calls an address found at compile time (`sharing`).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from uwserver.physics.kernel.choice import VARIABLE, is_plain

IS_PLAIN = is_plain(os.environ.get(VARIABLE))


def made_of(package: Path) -> str:
    """Return a hash of all sources of a package: numba itself notices no edit of a function that a kernel of another file calls."""
    return hash_of(package, sorted(package.rglob("*.py")))


def hash_of(package: Path, sources: Iterable[Path], versions: str = "") -> str:
    """Return a hash of some files below a folder, of their names, and of a text that says by what they are compiled."""
    digest = hashlib.sha256(versions.encode())
    for source in sources:
        digest.update(source.relative_to(package).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def part(function: Callable[..., Any], inlined: bool = False) -> Any:
    """Compile a function for kernels to call; it is not kept by itself, as each kernel that calls it holds it."""
    import numba

    return numba.njit(nogil=True, error_model="numpy", forceinline=inlined)(function)


def entry(function: Callable[..., Any], folder: Path | None) -> Any:
    """Compile a function for Python to call, and keep it in a folder; in none where `folder` is None."""
    import numba

    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder or "")
    try:
        kernel = numba.njit(nogil=True, error_model="numpy", cache=folder is not None)(function)
    finally:
        numba.config.CACHE_DIR = before
    kernel.load = lambda *like: kernel.compile(tuple(numba.typeof(argument) for argument in like))
    return kernel


def kept(folder: Path) -> set[str]:
    """Return the names of the kernels that a folder holds, each as "module.function"."""
    return {index.name.rpartition("-")[0] for index in folder.rglob("*.nbi")}
