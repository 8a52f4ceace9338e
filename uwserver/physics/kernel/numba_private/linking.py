"""How kernels become machine code: each entry is linked from all that it calls, and optimised once.

numba by itself optimises every function that a kernel calls, and makes machine code of it, at each level of calls anew; and it compiles a
function once for every whole number that is written at a call, as the number of a row. Both together took two thirds of the time. Here what
kernels call (a part) is only typed and translated. What Python calls (an entry) takes in the parts that it needs, straight and through other
parts, as its own: names of parts mean nothing outside, so that kernels made by different processes can be loaded side by side.
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
"""No GIL, IEEE division, no re-association (the same bits on every CPU), and no second door for callers in C."""

_ENVIRONMENT = "_ZN08NumbaEnv"
_NAME, _WRAPPER = "_ZN", "_ZN7cpython"
"""What a name of machine code begins with, and what that of the door begins with by which Python comes to it."""


class _PartCode(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """Code of a part: as translated, for entries to take in."""

    def finalize(self) -> None:
        self._finalized = True


class _EntryCode(JITCodeLibrary):  # type: ignore[misc]
    """Code of an entry: with all parts, optimised, and compiled."""

    def finalize(self) -> None:
        self._linking_libraries: Any = list(_closure(self._linking_libraries))
        super().finalize()
        for variable in self._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT) and (environment := lookup_environment(variable.name)):
                self._codegen.set_env(variable.name, environment)

    def _optimize_final_module(self) -> None:
        made = [function for function in self._final_module.functions if not function.is_declaration]
        doors = {function.name for function in made if function.name.startswith(_WRAPPER)}
        # Python comes by its door, a kernel that runs others (`calling`) straight to what lies behind it.
        kept = doors | {_NAME + door.removeprefix(_WRAPPER) for door in doors}
        for function in made:
            if function.name not in kept:
                function.linkage = binding.Linkage.internal
        super()._optimize_final_module()


def _closure(libraries: Iterable[Any]) -> dict[Any, None]:
    """Libraries and what their parts need, each once, in the order in which they are met."""
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
    """numba's compiler, into a library of ours."""

    code = _EntryCode

    def __init__(self, typing: Any, target: Any, library: Any, args: Any, result: Any, flags: Any, names: Any) -> None:
        super().__init__(typing, target, library, args, result, flags, names)
        self.state.library = self.code(target.codegen(), "kernel")
        self.state.library.enable_object_caching()


class _PartCompiler(_EntryCompiler):
    """The same, up to the machine code."""

    code = _PartCode

    def __init__(self, typing: Any, target: Any, library: Any, args: Any, result: Any, flags: Any, names: Any) -> None:
        flags = flags.copy()
        flags.no_compile = True
        super().__init__(typing, target, library, args, result, flags, names)

    def compile_extra(self, function: Any) -> Any:
        result = super().compile_extra(function)
        # By this its callers name it.
        name = object()
        self.state.targetctx.insert_user_function(name, result.fndesc, [result.library])
        return result._replace(entry_point=name)


class _SeparateCompiler(_PartCompiler):
    """The same, for a part that stays a function of its own."""

    def compile_extra(self, function: Any) -> Any:
        result = super().compile_extra(function)
        result.library.get_function(result.fndesc.llvm_func_name).add_function_attribute("noinline")
        return result


class Entry(registry.CPUDispatcher):  # type: ignore[misc]
    """What Python calls, and no kernel: nothing of it is left to be called."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function, targetoptions=dict(_OPTIONS), pipeline_class=_EntryCompiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        raise errors.TypingError(f"{self.__name__} is an entry: kernels call what is `compiled`")

    def load(self, *like: Any) -> None:
        """Be ready for arguments like these: from the cache, or compiled now."""
        self.compile(tuple(typeof(argument) for argument in like))


class Part(registry.CPUDispatcher):  # type: ignore[misc]
    """What kernels call. Called from Python, as tests do, it becomes an entry of its own."""

    def __init__(self, function: Callable[..., Any], make_entry: Callable[..., Any], *, inlined: bool | None) -> None:
        """`inlined` into its callers always, never, or (None) where the optimiser thinks best."""
        options = _OPTIONS | {"no_cpython_wrapper": True, "forceinline": inlined is True}
        super().__init__(
            function, targetoptions=options, pipeline_class=_SeparateCompiler if inlined is False else _PartCompiler
        )
        self._make_entry = make_entry
        self._entry: Any = None

    def add_overload(self, result: Any) -> None:
        self.overloads[tuple(result.signature.args)] = result

    def get_call_template(self, args: Any, kws: Any) -> Any:
        # One version for all rows that are named by a constant.
        kws = {name: unliteral(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(unliteral(kind) for kind in args), kws)

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        if self._entry is None:
            self._entry = self._make_entry(self.py_func)
        return self._entry
