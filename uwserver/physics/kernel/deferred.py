"""Kernels that stand in the file of what they belong to, beside its tables: marked here, and given to numba when one of them is called first.

numba costs half a second to import, which a command line that only reads tables must not pay. So these decorators know nothing of it; at the
first call a kernel is made from its function, with every kernel that it names, by the decorators of `compiled` of the same names.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import CellType, FunctionType
from typing import Any, Literal

from uwserver.physics.kernel.store import names_of

Form = Literal["compiled", "inlined", "separate", "entry"]


class Deferred:
    """A function that becomes a kernel.

    Attributes:
        py_func: the function as written, as of numba's kernels.
    """

    def __init__(self, function: Callable[..., Any], form: Form) -> None:
        self.py_func = function
        self._form = form
        self._made: Any = None
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def made(self) -> Any:
        """What numba has made of it."""
        if self._made is None:
            from uwserver.physics.kernel import compiled

            self._made = getattr(compiled, self._form)(_resolved(self.py_func))
        return self._made

    def __call__(self, *args: Any) -> Any:
        return self.made()(*args)


def compiled(function: Callable[..., Any]) -> Deferred:
    """As `compiled.compiled`."""
    return Deferred(function, "compiled")


def inlined(function: Callable[..., Any]) -> Deferred:
    """As `compiled.inlined`."""
    return Deferred(function, "inlined")


def separate(function: Callable[..., Any]) -> Deferred:
    """As `compiled.separate`."""
    return Deferred(function, "separate")


def entry(function: Callable[..., Any]) -> Deferred:
    """As `compiled.entry`."""
    return Deferred(function, "entry")


def _resolved(function: Any) -> FunctionType:
    """The function, which names kernels where it named what becomes one."""
    given = function.__globals__
    names = {name: _kernel(given[name]) for name in names_of(function.__code__) if name in given}
    cells = tuple(CellType(_kernel(cell.cell_contents)) for cell in function.__closure__ or ())
    # numba looks up the module of a function by its globals.
    scope = {**names, "__name__": function.__module__, "__builtins__": given["__builtins__"]}
    made = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, cells)
    made.__qualname__, made.__module__, made.__doc__ = function.__qualname__, function.__module__, function.__doc__
    return made


def _kernel(value: Any) -> Any:
    return value.made() if isinstance(value, (Deferred, Elsewhere)) else value


class Elsewhere:
    """A kernel of a module that needs numba to be imported, by its name."""

    def __init__(self, module: str, name: str) -> None:
        self._module, self._name = module, name

    def made(self) -> Any:
        """The kernel."""
        return getattr(import_module(self._module), self._name)
