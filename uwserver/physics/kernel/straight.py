"""Calls of entries without a search for the version that fits the arguments: an entry has one. The search costs as much as a small kernel does.
And where the machine code of that version lies, for kernels that call it themselves."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any


def straight(kernel: Any) -> Callable[..., Any]:
    """What an entry that is loaded runs, for arrays of the types for which it was, which nobody checks then; the entry itself where it is not loaded,
    or for several."""
    if len(kernel.overloads) != 1:
        return kernel  # type: ignore[no-any-return]  # numba has no types
    return _run_of(kernel)


@cache
def _run_of(kernel: Any) -> Callable[..., Any]:
    """Found once: to hash the types of a version takes 10 us."""
    (only,) = kernel.overloads.values()
    run: Callable[..., Any] = only.entry_point
    return run


def address_of(kernel: Any, gives: str) -> int:
    """Where the machine code of an entry lies that is loaded and gives such a result ("int64", "float64", "none", or another type of numba;
    `calling`); 0 where it does not, or is loaded for several."""
    return _address_of(kernel, gives) if len(kernel.overloads) == 1 else 0


@cache
def _address_of(kernel: Any, gives: str) -> int:
    (only,) = kernel.overloads.values()
    if str(only.signature.return_type) != gives:
        return 0
    code = only._asdict()["library"]  # as numba calls machine code that is loaded together
    return int(code.get_pointer_to_function(only.fndesc.llvm_func_name))
