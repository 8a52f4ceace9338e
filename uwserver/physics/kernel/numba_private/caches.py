"""How numba keeps and loads the kernels of this package: by what they are made of, not by path and time of a file.

Of an entry only its machine code is kept. numba would also keep the intermediate code of all that a kernel calls, for other kernels that may call it,
and parse both at each start: half a second and 75 MB for the kernels of a world.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any

from llvmlite import binding
from numba.core import caching, compiler
from numba.core.serialize import dumps

_UNREADABLE = (
    pickle.UnpicklingError, EOFError, OSError, RuntimeError, ImportError, AttributeError, IndexError, KeyError, TypeError, ValueError
)  # fmt: skip
"""Exceptions that an intact file with wrong content can cause."""


def file_name(kernel: str, signature: Any) -> str:
    """Return the name of the file that holds a kernel for arguments of these types."""
    kinds = hashlib.sha256(str(signature).encode()).hexdigest()[:16]
    return f"{kernel}-{kinds}.kernel"


class EntryCache(caching._Cache):  # type: ignore[misc]  # noqa: SLF001  # the base that numba's dispatchers ask for
    """The files of one entry."""

    def __init__(
        self,
        kernel: Callable[[], str],
        read: Callable[[str], Iterable[bytes | None]],
        write: Callable[[str, bytes], None] | None,
    ) -> None:
        """Make the cache of an entry.

        Args:
            kernel: returns its name.
            read: yields the contents of the file of a name in each folder, the best first.
            write: keeps bytes under such a name; None if nothing is kept.
        """
        self._name, self._read, self._write = kernel, read, write

    @cached_property
    def _kernel(self) -> str:
        return self._name()

    @property
    def cache_path(self) -> None:
        """None, as there is no single folder."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for these types, or None."""
        target_context.refresh()
        loaded = (_load(body, target_context) for body in self._read(file_name(self._kernel, sig)))
        return next((kernel for kernel in loaded if kernel is not None), None)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel."""
        code = data._asdict()["library"]  # numba's name for machine code that is loaded together
        if self._write is not None and not code.has_dynamic_globals:
            self._write(file_name(self._kernel, sig), dumps(_reduced(data)))

    def enable(self) -> None:
        """Do nothing: the cache is always enabled."""

    def disable(self) -> None:
        """Do nothing: the cache cannot be disabled."""

    def flush(self) -> None:
        """Do nothing: the files stay."""


def _load(body: bytes | None, target_context: Any) -> Any:
    if body is None:
        return None
    try:
        return compiler.CompileResult._rebuild(target_context, *pickle.loads(body))  # noqa: SLF001
    except _UNREADABLE:
        return None


def _reduced(result: Any) -> tuple[Any, ...]:
    """Return what is written for a kernel. In place of the intermediate code stand empty functions with the names by which numba finds the machine
    code."""
    (name, kind, (machine_code, _)), *rest = result._reduce()  # noqa: SLF001
    names = result.fndesc.llvm_cpython_wrapper_name, result.fndesc.llvm_func_name
    stubs = "\n".join(f'define void @"{each}"() {{ ret void }}' for each in names)
    return (name, kind, (machine_code, binding.parse_assembly(stubs).as_bitcode())), *rest
