"""The decorators that compile a kernel, and where the compiled code is kept.

numba's own cache does not notice when a function that a kernel calls changes in another module, so the cache folder carries a hash of
all files that hold kernels, and of what those import of physics (`kernel_sources`). In order of preference the folder lies in
``NUMBA_CACHE_DIR``, then in the user's cache folder; when neither can be written, kernels are compiled in memory at each start, and
`cache_state` says so.
"""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numba

from uwserver.physics.kernel.caches import EntryCache, FinishedCache, KernelCache

F = TypeVar("F", bound=Callable[..., Any])

ENTRY_KERNELS = (
    "integrator.advance",
    "integrator.rates_of_change",
    "step.strike",
    "step.settle",
    "flow.fill_flows",
    "flow.water_at",
)
"""What Python calls; numba keeps an index file of each once it is compiled, after all that it calls."""


_DECORATOR = re.compile(rb"^@(?:compiled|inlined|entry)\b", re.MULTILINE)
_IMPORT = re.compile(rb"^\s*from uwserver\.physics((?:\.\w+)*) import (\([^)]*\)|[^(\n]+)", re.MULTILINE)


class CacheState(NamedTuple):
    """Where compiled kernels are kept; `folder` is None when they are not. `reason` says why, or why the folder is only read."""

    folder: Path | None
    warm: bool
    reason: str


def kernel_sources(package: Path) -> tuple[Path, ...]:
    """The files below a package's folder that decide what its kernels do: those that hold one, and what they import of the package.

    The second kind counts because numba freezes the constants that a kernel names. An edit of any other file leaves the cache as it is.

    Args:
        package: folder of `uwserver.physics`, or a copy of it.
    """
    sources = {
        path.relative_to(package).with_suffix("").as_posix(): path.read_bytes() for path in package.rglob("*.py")
    }
    wanted = {name for name, text in sources.items() if _DECORATOR.search(text)}
    todo = list(wanted)
    while todo:
        for folder, names in _IMPORT.findall(sources[todo.pop()]):
            base = folder.decode().replace(".", "/").lstrip("/")
            named = {f"{base}/{name}".lstrip("/") for name in re.findall(r"\w+", names.decode())} | {base}
            new = (named & sources.keys()) - wanted
            wanted |= new
            todo += new
    return tuple(package / f"{name}.py" for name in sorted(wanted))


def _sources_hash(package: Path) -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for source in kernel_sources(package):
        digest.update(source.relative_to(package).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _base() -> Path:
    configured = os.environ.get("NUMBA_CACHE_DIR")
    if configured:
        return Path(configured)
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path("~/.cache").expanduser()) / "uwserver"


def _find_cache() -> CacheState:
    try:
        folder = _base() / f"kernels-{_sources_hash(Path(__file__).parents[1])}"
        # A read-only image holds a finished cache: reading it is enough.
        warm = all(any(folder.glob(f"**/{kernel}-*.nbi")) for kernel in ENTRY_KERNELS)
        if warm and not os.access(folder, os.W_OK):
            return CacheState(folder, True, "read-only, complete")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder
        return CacheState(None, False, f"kernel cache not writable ({error}): compiling in memory at each start")
    return CacheState(folder, warm, "")


cache_state = _find_cache()
if cache_state.folder is not None:
    # Read by numba when a function is decorated.
    numba.config.CACHE_DIR = str(cache_state.folder)


def inlined(function: F) -> F:
    """As `compiled`, and inlined into its callers: so the optimiser drops the reference counts of the arrays that are passed on."""
    return cast("F", numba.njit(nogil=True, error_model="numpy", forceinline=True)(function))


def compiled(function: F) -> F:
    """Compile to machine code: no GIL, IEEE division, no re-association (the same bits on every CPU)."""
    return _cached(function, KernelCache)


def entry(function: F) -> F:
    """As `compiled`, for what Python calls and no kernel: it is loaded several times as fast, in a fraction of the memory (`caches`)."""
    kernel: Any = _cached(function, EntryCache)

    def refuse(args: object, kws: object) -> None:
        raise numba.errors.TypingError(f"{function.__name__} is an entry: kernels call what is `compiled`")

    kernel.get_call_template = refuse
    return cast("F", kernel)


def _cached(function: F, cache: type[KernelCache]) -> F:
    kernel = numba.njit(nogil=True, error_model="numpy")(function)
    if cache_state.folder is not None:
        # What njit(cache=True) does, with a class of our own.
        kernel._cache = (FinishedCache if cache_state.reason else cache)(function)  # noqa: SLF001
    return cast("F", kernel)
