"""How kernels become machine code: each entry is linked from all that it calls, and optimised once.

numba itself optimises every function that a kernel calls, and makes machine code of it, anew at each level of calls. It also compiles a function once
for every literal whole number at a call, such as the number of a row. Both together took two thirds of the time. Here a function that kernels call (a
part) is only typed and translated. A function that Python calls (an entry) takes in all parts that it needs, directly or through other parts, as its
own code. Names of parts have no meaning outside an entry, so kernels made by different processes can be loaded side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from llvmlite import binding
from numba import typeof
from numba.core import compiler, errors, registry
from numba.core.codegen import JITCodeLibrary
from numba.core.environment import lookup_environment
from numba.core.types import unliteral  # type: ignore[attr-defined]  # made at run time

_OPTIONS = {"nopython": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""No GIL, IEEE division, no re-association (the same bits on every CPU), and no wrapper for callers in C."""

_ENVIRONMENT = "_ZN08NumbaEnv"
_NAME, _WRAPPER = "_ZN", "_ZN7cpython"
"""Prefix of the names of machine code, and that of the wrappers through which Python calls it."""


class _PartCode(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """The code of a part, as translated, for entries to take in."""

    def finalize(self) -> None:
        self._finalized = True


class _EntryCode(JITCodeLibrary):  # type: ignore[misc]
    """The code of an entry with all its parts, optimised and compiled."""

    def finalize(self) -> None:
        self._linking_libraries: Any = list(_closure(self._linking_libraries))
        super().finalize()
        for variable in self._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT) and (environment := lookup_environment(variable.name)):
                self._codegen.set_env(variable.name, environment)

    def _optimize_final_module(self) -> None:
        made = [function for function in self._final_module.functions if not function.is_declaration]
        doors = {function.name for function in made if function.name.startswith(_WRAPPER)}
        # Python calls the wrapper; a kernel that calls others by address (`calling`) calls the function behind it.
        kept = doors | {_NAME + door.removeprefix(_WRAPPER) for door in doors}
        for function in made:
            if function.name not in kept:
                function.linkage = binding.Linkage.internal
        super()._optimize_final_module()


def _closure(libraries: Iterable[Any]) -> dict[Any, None]:
    """Return libraries and all parts that they need, each once, in the order in which they are found."""
    found: dict[Any, None] = {}
    todo = list(libraries)[::-1]
    while todo:
        library = todo.pop()
        if library not in found:
            found[library] = None
            if isinstance(library, _PartCode):
                todo += library._linking_libraries[::-1]  # noqa: SLF001
    return found


class _EntryCompiler(compiler.Compiler):  # type: ignore[misc]
    """numba's compiler with our library for its code."""

    code = _EntryCode

    def __init__(self, typing: Any, target: Any, library: Any, args: Any, result: Any, flags: Any, names: Any) -> None:
        super().__init__(typing, target, library, args, result, flags, names)
        self.state.library = self.code(target.codegen(), "kernel")
        self.state.library.enable_object_caching()


class _PartCompiler(_EntryCompiler):
    """The same for a part: it stops before the machine code."""

    code = _PartCode

    def __init__(self, typing: Any, target: Any, library: Any, args: Any, result: Any, flags: Any, names: Any) -> None:
        flags = flags.copy()
        flags.no_compile = True
        super().__init__(typing, target, library, args, result, flags, names)

    def compile_extra(self, function: Any) -> Any:
        result = super().compile_extra(function)
        # Callers refer to the part by this object.
        name = object()
        self.state.targetctx.insert_user_function(name, result.fndesc, [result.library])
        return result._replace(entry_point=name)


class _SeparateCompiler(_PartCompiler):
    """The same for a part that is never inlined."""

    def compile_extra(self, function: Any) -> Any:
        result = super().compile_extra(function)
        result.library.get_function(result.fndesc.llvm_func_name).add_function_attribute("noinline")
        return result


class Entry(registry.CPUDispatcher):  # type: ignore[misc]
    """A function that Python calls and no kernel does. Nothing of it is left for kernels to call."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function, targetoptions=dict(_OPTIONS), pipeline_class=_EntryCompiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        raise errors.TypingError(f"{self.__name__} is an entry: kernels call what is `compiled`")

    def load(self, *like: Any) -> None:
        """Compile for arguments like these, or load from the cache."""
        self.compile(tuple(typeof(argument) for argument in like))


class Part(registry.CPUDispatcher):  # type: ignore[misc]
    """A function that kernels call. If Python calls it, as tests do, it becomes an entry of its own."""

    def __init__(self, function: Callable[..., Any], make_entry: Callable[..., Any], *, inlined: bool | None) -> None:
        """Make a part; `inlined` into its callers always, never, or (None) where the optimiser decides so."""
        options = _OPTIONS | {"no_cpython_wrapper": True, "forceinline": inlined is True}
        super().__init__(
            function, targetoptions=options, pipeline_class=_SeparateCompiler if inlined is False else _PartCompiler
        )
        self._make_entry = make_entry
        self._entry: Any = None

    def add_overload(self, result: Any) -> None:
        self.overloads[tuple(result.signature.args)] = result

    def get_call_template(self, args: Any, kws: Any) -> Any:
        # One version serves all literal numbers of rows.
        kws = {name: unliteral(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(unliteral(kind) for kind in args), kws)

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        if self._entry is None:
            self._entry = self._make_entry(self.py_func)
        return self._entry
