"""Makes machine code for other CPUs than this one, as kernels are compiled: for wheels, in a process that does nothing else.

numba types a kernel and translates it into LLVM's intermediate code, which takes most of the time and does not depend on the CPU. Only the optimiser
and the code generator do. So they run once more here for each kind of CPU. For the kind that this process compiles for, the code is the same to the
last byte as what the process itself runs.

It relies on private parts of numba, as `uwserver.physics.kernel.numba_private` does, and stands here because only builds need it. Of what our kernels
name, two things belong to a machine: the instruction that waits, and the number of the futex system call (`places`). They are
replaced in the text of the intermediate code; whatever else of another machine were left is an error of LLVM, or of `emit`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from llvmlite import binding
from numba.core import config
from numba.core.codegen import JITCodeLibrary
from numba.core.serialize import dumps

from uwserver.physics.kernel.numba_private import caches, linking

_TRIPLES = {"x86_64": "x86_64-unknown-linux-gnu", "aarch64": "aarch64-unknown-linux-gnu"}
_CPUS = {"aarch64": "generic"}
"""LLVM's name of the plainest CPU, where it is not that of the level."""
_RELOCATIONS = {"x86_64": "static"}
"""As numba chooses them; elsewhere LLVM's default."""
_HERE = "x86_64"
_OF_HERE = re.compile(r"@llvm\.x86\.")
_PAUSE = {"aarch64": ("@llvm.x86.sse2.pause()", "@llvm.aarch64.hint(i32 1)", "@llvm.aarch64.hint(i32)")}
"""The instruction here, there, and its declaration there."""
_FUTEX = {"aarch64": ("@syscall(i64 202,", "@syscall(i64 98,")}


class Level(NamedTuple):
    """A kind of CPU.

    Attributes:
        machine: as `platform.machine()` calls it.
        name: `x86-64-v3`, for instance.
        features: LLVM's names of what it needs beyond the plainest CPU.
    """

    machine: str
    name: str
    features: Sequence[str]


class Untranslatable(Exception):
    """A kernel names something that only this machine has."""


def emit(levels: Sequence[Level], keep: Callable[[Level, str, bytes], None], own: Level | None = None) -> None:
    """From now on, make code for these kinds of CPU of each entry that is compiled and kept.

    Args:
        levels: kinds of CPU.
        keep: takes the kind, the name of the file, and its content.
        own: the one of them for which this process compiles, by its settings: its code is there already.
    """
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    machines = {level: _target_machine(level) for level in levels}
    _keep_before_code_generation()
    linking._EntryCompiler.code = _KeptEntryCode  # noqa: SLF001
    save = caches.EntryCache.save_overload

    def save_all(self: Any, signature: Any, result: Any) -> None:
        for level, machine in machines.items():
            name = caches.file_name(self._kernel, signature)
            code = None if level == own else _machine_code(result.library, level, machine)
            keep(level, name, _content(result, code))
        save(self, signature, result)

    caches.EntryCache.save_overload = save_all  # type: ignore[method-assign]


class _KeptEntryCode(linking._EntryCode):  # noqa: SLF001
    """Keeps the intermediate code of an entry and all its parts, before any optimisation."""

    def _optimize_final_module(self) -> None:
        self.intermediate: bytes = self._final_module.as_bitcode()
        super()._optimize_final_module()


def _keep_before_code_generation() -> None:
    """Let entries take in numba's own functions as they are before code generation, which puts instructions of this machine in."""
    finalize, linked = JITCodeLibrary._finalize_final_module, JITCodeLibrary._get_module_for_linking  # noqa: SLF001

    def finalize_and_keep(self: Any) -> None:
        self.before = self._final_module.clone()
        finalize(self)

    def module_for_linking(self: Any) -> Any:
        self._ensure_finalized()
        made, self._final_module = self._final_module, getattr(self, "before", self._final_module)
        try:
            return linked(self)
        finally:
            self._final_module = made

    JITCodeLibrary._finalize_final_module = finalize_and_keep  # noqa: SLF001
    JITCodeLibrary._get_module_for_linking = module_for_linking  # noqa: SLF001


def _target_machine(level: Level) -> Any:
    target = binding.Target.from_triple(_TRIPLES[level.machine])
    return target.create_target_machine(
        cpu=_CPUS.get(level.machine, level.name),
        features=",".join(f"+{feature}" for feature in level.features),
        opt=config.OPT,
        reloc=_RELOCATIONS.get(level.machine, "default"),
        codemodel="jitdefault",
        jit=True,
    )


def _machine_code(library: Any, level: Level, machine: Any) -> bytes:
    """Return the object file of an entry for a kind of CPU.

    Raises:
        Untranslatable: it holds something of this machine.
    """
    module = binding.parse_bitcode(library.intermediate)
    if level.machine != _HERE:
        module = binding.parse_assembly(translated(str(module), level.machine))
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    codegen = library._codegen  # noqa: SLF001
    made = codegen._tm, library._final_module  # noqa: SLF001
    codegen._tm, library._final_module = machine, module  # noqa: SLF001
    try:
        linking._EntryCode._optimize_final_module(library)  # noqa: SLF001
        return bytes(machine.emit_object(library._final_module))  # noqa: SLF001
    finally:
        codegen._tm, library._final_module = made  # noqa: SLF001


def translated(text: str, machine: str) -> str:
    """Return intermediate code with what belongs to this machine replaced by what another has.

    Raises:
        Untranslatable: something of this machine is left.
    """
    here, there, declared = _PAUSE[machine]
    text = text.replace(f"declare void {here}", f"declare void {declared}").replace(here, there)
    text = text.replace(*_FUTEX[machine])
    left = _OF_HERE.search(text)
    calls = len(re.findall(r"@syscall\(i64 \d", text)) - text.count(_FUTEX[machine][1])
    if left is not None or calls:
        raise Untranslatable(text[left.start() : left.start() + 60] if left else "a system call that is no futex")
    return text


def _content(result: Any, code: bytes | None) -> bytes:
    """Return the file of a kernel with this machine code, or with its own."""
    (name, kind, (own, stubs)), *rest = caches._reduced(result)  # noqa: SLF001
    return bytes(dumps(((name, kind, (own if code is None else code, stubs)), *rest)))
