"""Calls an entry without numba's search for the version that fits the arguments: an entry has one version, and the search takes as long as a small
kernel. Also returns the address of its machine code, for kernels that call it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any


def straight(kernel: Any) -> Callable[..., Any]:
    """Return the machine code of a loaded entry as a function. It does not check the types of its arguments. If the entry is not loaded, or has
    several versions, return the entry itself."""
    if len(kernel.overloads) != 1:
        return kernel  # type: ignore[no-any-return]  # numba has no types
    return _run_of(kernel)


@cache
def _run_of(kernel: Any) -> Callable[..., Any]:
    """Return the function of the only version. The result is cached, because hashing the types of a version takes 10 us."""
    (only,) = kernel.overloads.values()
    run: Callable[..., Any] = only.entry_point
    return run


def address_of(kernel: Any, gives: str) -> int:
    """Return the address of the machine code of a loaded entry with this type of result ("int64", "float64", "none", or another type of numba; see
    `calling`). Return 0 if it has another type, or is not loaded for exactly one version."""
    return _address_of(kernel, gives) if len(kernel.overloads) == 1 else 0


@cache
def _address_of(kernel: Any, gives: str) -> int:
    (only,) = kernel.overloads.values()
    if str(only.signature.return_type) != gives:
        return 0
    code = only._asdict()["library"]  # numba's name for machine code that is loaded together
    return int(code.get_pointer_to_function(only.fndesc.llvm_func_name))
