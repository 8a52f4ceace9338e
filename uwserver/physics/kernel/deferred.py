"""Decorators for kernels that stand beside tables and fields, outside physics. They mark a function; numba gets it at the first call.

numba takes half a second to import, which a command that only reads tables must not cost. So these decorators do not import it. At the first call the
function, and every kernel that it names, is passed to the decorator of the same name in `compiled`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import CellType, FunctionType
from typing import Any, Literal

from uwserver.physics.kernel.store import names_of

Form = Literal["compiled", "inlined", "separate", "entry"]


class Deferred:
    """A function that becomes a kernel at its first call.

    Attributes:
        py_func: the function as written, as numba's kernels have it.
    """

    def __init__(self, function: Callable[..., Any], form: Form) -> None:
        self.py_func = function
        self._form = form
        self._made: Any = None
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def made(self) -> Any:
        """Return the kernel; make it if it does not exist yet."""
        if self._made is None:
            from uwserver.physics.kernel import compiled

            self._made = getattr(compiled, self._form)(_resolved(self.py_func))
        return self._made

    def __call__(self, *args: Any) -> Any:
        return self.made()(*args)


compiled = partial(Deferred, form="compiled")
inlined = partial(Deferred, form="inlined")
separate = partial(Deferred, form="separate")
entry = partial(Deferred, form="entry")
"""The decorators. Each does what the one of the same name in `uwserver.physics.kernel.compiled` does, when the function is called first."""


def _resolved(function: Any) -> FunctionType:
    """Return a copy of the function in which the names of deferred kernels refer to the kernels themselves."""
    given = function.__globals__
    names = {name: _kernel(given[name]) for name in names_of(function.__code__) if name in given}
    cells = tuple(CellType(_kernel(cell.cell_contents)) for cell in function.__closure__ or ())
    # numba finds the module of a function by its globals.
    scope = {**names, "__name__": function.__module__, "__builtins__": given["__builtins__"]}
    made = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, cells)
    made.__qualname__, made.__module__, made.__doc__ = function.__qualname__, function.__module__, function.__doc__
    return made


def _kernel(value: Any) -> Any:
    return value.made() if isinstance(value, (Deferred, Elsewhere)) else value


class Elsewhere:
    """Names a kernel of a module that imports numba."""

    def __init__(self, module: str, name: str) -> None:
        self._module, self._name = module, name

    def made(self) -> Any:
        """Import the module and return the kernel."""
        return getattr(import_module(self._module), self._name)
