"""What a kernel is made of, as a hash: its code, that of all it calls, and the constants that numba freezes into it.

Kernels outside physics stand beside tables and fields, which change often: so their cache goes by the code alone, and neither by files nor by
lines. Functions of physics count by their names, as the folder of the cache already tells their sources.
"""

from __future__ import annotations

import enum
import hashlib
from collections.abc import Callable
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

PHYSICS = "uwserver.physics."
_SIZE = 12


def names_of(code: CodeType) -> set[str]:
    """Names that a function, or what it defines, may look up."""
    return set(code.co_names).union(*(names_of(c) for c in code.co_consts if isinstance(c, CodeType)))


def fingerprint(function: Callable[..., Any]) -> str:
    """Hash of a function as written, and of all that it may name; the same in every process of a version of Python."""
    digest = hashlib.sha256()
    _tell(function, lambda text: digest.update(text.encode() + b"\0"), {})
    return digest.hexdigest()[:_SIZE]


def kernel_name(function: Callable[..., Any]) -> str:
    """A kernel's module and name; outside physics, whose sources the folder's name tells, with the hash of what it is made of."""
    name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
    return name if function.__module__.startswith(PHYSICS) else f"{name}+{fingerprint(function)}"


def _tell(value: Any, say: Callable[[str], None], met: dict[int, int]) -> None:
    """Say what a value is. What numba could make no machine code of is never part of a kernel, and left out."""
    value = getattr(value, "py_func", value)
    if isinstance(value, FunctionType):
        _tell_function(value, say, met)
    elif isinstance(value, tuple | frozenset):
        say(f"{type(value).__qualname__} {len(value)}")
        for item in value if isinstance(value, tuple) else sorted(value, key=repr):
            _tell(item, say, met)
    elif isinstance(value, np.ndarray):
        say(f"array {value.dtype!r} {value.shape} {hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}")
    elif isinstance(value, type):
        members = list(value) if issubclass(value, enum.Enum) else getattr(value, "_fields", "")
        say(f"{value.__module__}.{value.__qualname__} {members!r}")
    elif isinstance(value, ModuleType | BuiltinFunctionType | np.ufunc):
        say(f"{value.__name__}")
    elif isinstance(value, CodeType):
        say(f"{value.co_code.hex()} {value.co_names} {value.co_varnames} {value.co_freevars}")
        for constant in value.co_consts:
            _tell(constant, say, met)
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes | np.dtype | np.generic):
        say(f"{type(value).__name__} {value!r}")


def _tell_function(function: FunctionType, say: Callable[[str], None], met: dict[int, int]) -> None:
    if id(function) in met:
        say(f"again {met[id(function)]}")
        return
    met[id(function)] = len(met)
    say(f"{function.__module__}.{function.__qualname__}")
    if not function.__module__.startswith(PHYSICS):
        code = function.__code__
        # The text about a function stands among its constants.
        constants = tuple(c for c in code.co_consts if c != function.__doc__ or c is None)
        _tell(code.replace(co_consts=constants), say, met)
        _tell(function.__defaults__ or (), say, met)
        for name in sorted(names_of(code) & function.__globals__.keys()):
            say(name)
            _tell(function.__globals__[name], say, met)
    for cell in function.__closure__ or ():
        _tell(cell.cell_contents, say, met)
