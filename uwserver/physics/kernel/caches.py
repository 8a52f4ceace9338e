"""How numba keeps and loads the kernels of this package: by what they are made of, not by path and time of a file.

Of an entry only its machine code is kept. numba keeps the intermediate code of all that a kernel calls as well, for kernels that may call it,
and parses both at each start: half a second and 75 MB for those of a world.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from llvmlite import binding
from numba.core import caching, compiler
from numba.core.serialize import dumps

from uwserver.physics.kernel import store
from uwserver.physics.kernel.fingerprint import PHYSICS, fingerprint

_UNREADABLE = (
    pickle.UnpicklingError, EOFError, OSError, RuntimeError, ImportError, AttributeError, IndexError, KeyError, TypeError, ValueError
)  # fmt: skip
"""What a file can lead to that is sound and yet not what it should be."""


def file_name(kernel: str, signature: Any) -> str:
    """Of the file that holds a kernel for arguments of these types."""
    kinds = hashlib.sha256(str(signature).encode()).hexdigest()[:16]
    return f"{kernel}-{kinds}.kernel"


def kernel_name(function: Callable[..., Any]) -> str:
    """A kernel's module and name; outside physics, whose sources the folder's name tells, with the hash of what it is made of."""
    name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
    return name if function.__module__.startswith(PHYSICS) else f"{name}+{fingerprint(function)}"


class EntryCache(caching._Cache):  # type: ignore[misc]  # noqa: SLF001  # the base that numba's dispatchers ask for
    """Files of one entry, in the folders of `compiled.Folders`."""

    def __init__(self, function: Callable[..., Any], packaged: Sequence[Path], own: Path | None, kept: bool) -> None:
        """Search folders of the package, then the user's `own`; `kept`: what is compiled goes there."""
        self._function = function
        self._packaged = packaged
        self._own = own
        self._kept = kept

    @cached_property
    def _kernel(self) -> str:
        return kernel_name(self._function)

    @property
    def cache_path(self) -> str | None:
        """The user's folder."""
        return None if self._own is None else str(self._own)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel for these types, or None."""
        target_context.refresh()
        name = file_name(self._kernel, sig)
        for folder in self._packaged:
            if (found := _load(store.read(folder, name, packaged=True), target_context)) is not None:
                return found
        return None if self._own is None else _load(store.read(self._own, name), target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel, if there is a folder for it."""
        if self._kept and self._own is not None and not data.library.has_dynamic_globals:
            store.write(self._own, file_name(self._kernel, sig), dumps(_reduced(data)))

    def enable(self) -> None:
        """Always so."""

    def disable(self) -> None:
        """Never so."""

    def flush(self) -> None:
        """Files stay."""


def _load(body: bytes | None, target_context: Any) -> Any:
    if body is None:
        return None
    try:
        return compiler.CompileResult._rebuild(target_context, *pickle.loads(body))  # noqa: SLF001
    except _UNREADABLE:
        return None


def _reduced(result: Any) -> tuple[Any, ...]:
    """What is written. In place of the intermediate code stand empty functions of the names by which numba finds the machine code."""
    (name, kind, (machine_code, _)), *rest = result._reduce()  # noqa: SLF001
    names = result.fndesc.llvm_cpython_wrapper_name, result.fndesc.llvm_func_name
    stubs = "\n".join(f'define void @"{each}"() {{ ret void }}' for each in names)
    return (name, kind, (machine_code, binding.parse_assembly(stubs).as_bitcode())), *rest
