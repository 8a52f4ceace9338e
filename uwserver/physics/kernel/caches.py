"""How kernels are kept and loaded: numba's own cache, one for what only Python calls, and one that is finished.

numba keeps of a kernel its machine code, and beside it the intermediate code of all that it calls, for other kernels that may call it. At each
start it parses both, which for the kernels of a world costs half a second and 75 MB. What only Python calls needs the first alone.
"""

from __future__ import annotations

from typing import Any

from llvmlite import binding
from numba.core import caching

KernelCache = caching.FunctionCache


class _EntryFiles(caching.CompileResultCacheImpl):  # type: ignore[misc]  # numba has no types
    def reduce(self, result: Any) -> Any:
        """What is written. In place of the intermediate code stands an empty function of the name by which numba finds the machine code."""
        (name, kind, (machine_code, _)), *rest = super().reduce(result)
        stub = f'define void @"{result.fndesc.llvm_cpython_wrapper_name}"() {{ ret void }}'
        return (name, kind, (machine_code, binding.parse_assembly(stub).as_bitcode())), *rest


class EntryCache(caching.FunctionCache):  # type: ignore[misc]
    """Of kernels that no kernel calls."""

    _impl_class = _EntryFiles


class _Locator(caching.UserProvidedCacheLocator):  # type: ignore[misc]
    def ensure_cache_path(self) -> None:
        """Nothing is written."""


class _Files(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class FinishedCache(caching.FunctionCache):  # type: ignore[misc]
    """Loads kernels from a folder that cannot be written, as in a container image; numba's own caches insist on write access.

    One that is missing (another kind of CPU) is compiled in memory and not kept.
    """

    _impl_class = _Files

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps nothing."""
