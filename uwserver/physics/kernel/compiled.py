"""The decorators that compile a kernel, and where compiled code is kept.

The folder of the cache is named by a hash of all files of physics that contain kernels and of the files that these import of physics
(`kernel_sources`), of the versions of numba, llvmlite and Python, and of the CPU. So all environments of a user with the same kernels share one
folder. The name of a kernel outside physics contains a hash of its code (`store.fingerprint`). Kernels are looked for first in the package, which
contains them in wheels for a platform (`FINISHED`), then in the user's folder, below ``NUMBA_CACHE_DIR`` or in the cache folder. If that folder
cannot be used, kernels are compiled in memory at each start, and `cache_state` says why.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import llvmlite
import numba
from numba.core.codegen import get_host_cpu_features

from uwserver.physics.kernel import plain, store
from uwserver.physics.kernel.plain import IS_PLAIN
from uwserver.physics.kernel.store import PHYSICS, kernel_name

if not IS_PLAIN:
    from uwserver.physics.kernel.numba_private.caches import EntryCache
    from uwserver.physics.kernel.numba_private.linking import Entry, Part

F = TypeVar("F", bound=Callable[..., Any])

ENTRY_KERNELS = {
    "free": (
        "integrator.advance", "integrator.rates_of_change", "carrying.carry_alone", "carrying.find_rates_alone", "sharing.serve", "sharing.stop",
    ),
    "fins": ("integrator.advance_fitted", "integrator.rates_of_change_fitted"),
    "contact": ("step.strike", "step.finish_contacts"),
    "fins in contact": ("step.strike_fitted",),
    "sea": ("flow.fill_flows", "flow.water_at"),
    "solids": (
        "broad_phase.find_pairs", "broad_phase.place", "broad_phase.bound", "directions.find_lines", "directions.refine_lines",
        "narrow_phase.find_contacts", "mesh.fill_cells", "hits.intersect_simple", "hits.select_rays", "hits.refine",
        "meeting.meet", "tree.build", *(() if find_spec("embreex") else ("tree.pick_nearest",)),
    ),
    "echoes": ("hits.intersect_level",),
}  # fmt: skip
"""The kernels that Python calls, by what a world needs them for."""

LEVELS: dict[str, dict[str, tuple[str, ...]]] = {
    "x86_64": {
        "x86-64-v3": (
            "cx8", "cmov", "fxsr", "mmx", "sse", "sse2", "sse3", "ssse3", "sse4.1", "sse4.2", "popcnt", "cx16", "sahf",
            "avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave",
        ),
        "x86-64": (),
    },
    "aarch64": {"armv8-a": ()},
}  # fmt: skip
"""The kinds of CPU of each machine for which wheels contain kernels, the best first, with the features of LLVM that each needs."""

FINISHED = Path(__file__).with_name("finished")

_DECORATOR = re.compile(rb"^@(?:compiled|inlined|separate|entry)\b", re.MULTILINE)
_IMPORT = re.compile(rb"^\s*from uwserver\.physics((?:\.\w+)*) import (\([^)]*\)|[^(\n]+)", re.MULTILINE)


class CacheState(NamedTuple):
    """Where compiled kernels are kept; `folder` is None if they are not kept.

    Attributes:
        folder: that of the user.
        reason: why there is no folder, or why it cannot be written to.
        packaged: folders of the package that contain kernels for this CPU.
    """

    folder: Path | None
    reason: str
    packaged: tuple[Path, ...] = ()

    def missing(self, kernels: Iterable[str]) -> tuple[str, ...]:
        """Return those of some kernels that are not compiled yet."""
        folders = (*self.packaged, *(() if self.folder is None else (self.folder,)))
        if IS_PLAIN:
            there = {name for folder in folders for name in plain.kept(folder)}
            return tuple(kernel for kernel in kernels if kernel.partition("+")[0] not in there)
        there = {path.name.rpartition("-")[0] for folder in folders for path in folder.glob("*.kernel")}
        return tuple(kernel for kernel in kernels if kernel not in there)


def kernel_sources(package: Path) -> tuple[Path, ...]:
    """Return the files below a package's folder that decide what its kernels do: those that contain kernels, and those that these import from the
    package.

    Imported files count because numba freezes the constants that a kernel names. An edit of any other file does not affect the cache.

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


def made_of(package: Path, machine: str = "") -> str:
    """Return a hash of all that a kernel is made of except the CPU: the sources, and the versions of the tools that compile them.

    Args:
        package: folder of `uwserver.physics`, or a copy of it.
        machine: as `platform.machine` calls it; this one if empty.
    """
    here = machine or platform.machine()
    parts = numba.__version__, llvmlite.__version__, str(sys.implementation.cache_tag), sys.platform, here
    return plain.hash_of(package, kernel_sources(package), "\n".join(parts))


def _features() -> str:
    return str(numba.config.CPU_FEATURES if numba.config.CPU_FEATURES is not None else get_host_cpu_features())


def cpu_of() -> str:
    """Return a hash of the CPU that numba compiles for: its name and its features."""
    name = numba.config.CPU_NAME or llvmlite.binding.get_host_cpu_name()
    return hashlib.sha256(f"{name} {_features()}".encode()).hexdigest()[:8]


def _packaged(sources: str) -> tuple[Path, ...]:
    """Return the folders of the package whose kernels run on this CPU, the best first; none if the user chose a CPU by hand."""
    if IS_PLAIN:
        return ()
    levels = LEVELS.get(platform.machine(), {})
    if numba.config.CPU_NAME or numba.config.CPU_FEATURES is not None:
        return ()
    has = set(_features().split(","))
    fit = [level for level, needs in levels.items() if has >= {f"+{feature}" for feature in needs}]
    return tuple(folder for level in fit if (folder := FINISHED / f"{sources}-{level}").is_dir())


def _base() -> Path:
    configured = os.environ.get("NUMBA_CACHE_DIR")
    if configured:
        return Path(configured)
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path("~/.cache").expanduser()) / "uwserver"


def _find_cache() -> CacheState:
    sources = f"plain-{plain.made_of(Path(__file__).parents[2])}" if IS_PLAIN else made_of(Path(__file__).parents[1])
    packaged = _packaged(sources)
    try:
        folder = _base() / f"kernels-{sources}-{cpu_of()}"
        if not os.path.lexists(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
        fault = store.fault_of(folder)
        if fault:
            return CacheState(None, fault, packaged)
        # A read-only image contains a complete cache, which only has to be read.
        if not os.access(folder, os.W_OK):
            return CacheState(folder, "read-only", packaged)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder
        reason = f"kernel cache not writable ({error}): compiling in memory at each start"
        return CacheState(None, reason, packaged)
    return CacheState(folder, "", packaged)


cache_state = _find_cache()


def inlined(function: F) -> F:
    """Compile as `compiled` does, and inline the function into its callers. Then the optimiser drops the reference counts of the arrays that are
    passed."""
    return cast("F", plain.part(function, inlined=True) if IS_PLAIN else Part(function, entry, inlined=True))


def compiled(function: F) -> F:
    """Compile a function to machine code for kernels to call: no GIL, IEEE division, no re-association, so the same bits on every CPU."""
    return cast("F", plain.part(function) if IS_PLAIN else Part(function, entry, inlined=None))


def separate(function: F) -> F:
    """Compile as `compiled` does, and never inline the function. Use it for a long function that is called at many places, where each copy would be
    compiled anew."""
    return cast("F", plain.part(function) if IS_PLAIN else Part(function, entry, inlined=False))


def entry(function: F) -> F:
    """Compile a function that Python calls and no kernel does, into one piece of machine code with all that it calls (`linking`)."""
    state, module = cache_state, function.__module__ or ""
    # In physics a kernel is known by the name of the folder and its own name, which do not say what a closure holds. Kernels of tests are not kept.
    is_kept = module.startswith(("uwserver.", "uwserver_")) and not (
        module.startswith(PHYSICS) and "<locals>" in function.__qualname__
    )
    if IS_PLAIN:
        return cast("F", plain.entry(function, state.folder if is_kept else None))
    kernel = Entry(function)
    if is_kept:
        kernel._cache = files_of(function, state.packaged, state.folder, kept=not state.reason)  # noqa: SLF001
    return cast("F", kernel)


def files_of(function: Callable[..., Any], packaged: Sequence[Path], own: Path | None, kept: bool) -> EntryCache:
    """Return the files of an entry: in folders of the package, then in the user's folder `own`, where new code is written if `kept`."""

    def read(name: str) -> Iterator[bytes | None]:
        for folder in packaged:
            yield store.read(folder, name, packaged=True)
        if own is not None:
            yield store.read(own, name)

    return EntryCache(
        lambda: kernel_name(function), read, partial(store.write, own) if kept and own is not None else None
    )
