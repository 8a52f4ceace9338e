"""numba has the private parts on which `numba_private` relies. What fails here names what a new version of numba has changed."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite import binding
from numba.core import base, caching, codegen, compiler, environment, registry, serialize

from uwserver.physics.kernel.compiled import entry

REMEDY = (
    f"numba {numba.__version__} differs from what numba_private/ relies on: mend it there, or set UWSERVER_KERNELS=plain "
    "(uwserver.physics.kernel.plain), which needs none of this"
)

KNOWN: tuple[tuple[Callable[..., Any], str], ...] = (
    (codegen.JITCodeLibrary.finalize, "self"),
    (codegen.JITCodeLibrary._optimize_final_module, "self"),
    (codegen.JITCodeLibrary._finalize_final_module, "self"),
    (codegen.JITCodeLibrary._get_module_for_linking, "self"),
    (codegen.JITCodeLibrary.get_function, "self name"),
    (codegen.JITCodeLibrary.enable_object_caching, "self"),
    (codegen.JITCodeLibrary.get_pointer_to_function, "self name"),
    (environment.lookup_environment, "env_name"),
    (compiler.Compiler.__init__, "self typingctx targetctx library args return_type flags locals"),
    (compiler.Compiler.compile_extra, "self func"),
    (compiler.CompileResult._reduce, "self"),
    (base.BaseContext.insert_user_function, "self func fndesc libs"),
    (base.BaseContext.refresh, "self"),
    (serialize.dumps, "obj"),
    (registry.CPUDispatcher.__init__, "self py_func locals targetoptions pipeline_class"),
    (registry.CPUDispatcher.get_call_template, "self args kws"),
    (registry.CPUDispatcher.add_overload, "self cres"),
    (binding.parse_assembly, "llvmir context"),
)


@pytest.mark.parametrize(("function", "parameters"), KNOWN, ids=lambda given: getattr(given, "__qualname__", ""))
def test_a_function_takes_what_it_took(function: Callable[..., Any], parameters: str) -> None:
    assert tuple(inspect.signature(function).parameters) == tuple(parameters.split()), REMEDY


def test_a_cache_has_the_methods_that_ours_has() -> None:
    needed = {"cache_path", "disable", "enable", "flush", "load_overload", "save_overload"}
    assert caching._Cache.__abstractmethods__ == needed, REMEDY


def test_a_compiled_kernel_holds_what_the_linker_and_the_cache_look_at() -> None:
    @entry
    def half(numbers: Any) -> float:
        return 0.5 * float(numbers[0])

    assert half(np.array([3.0])) == 1.5
    (made,) = half.overloads.values()
    code = made._asdict()["library"]  # numba's name for machine code that is loaded together
    for name in ("_linking_libraries", "_final_module", "_finalized", "_codegen", "has_dynamic_globals"):
        assert hasattr(code, name), f"{name}: {REMEDY}"
    assert callable(code._codegen.set_env), REMEDY
    assert code._codegen._tm is not None, REMEDY  # tools/emitting.py
    for name in ("llvm_func_name", "llvm_cpython_wrapper_name"):
        assert hasattr(made.fndesc, name), f"{name}: {REMEDY}"
    (name, kind, (machine_code, _)), *_ = made._reduce()
    assert (type(name), kind, type(machine_code)) == (str, "object", bytes), REMEDY
