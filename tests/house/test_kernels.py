"""Kernels that Python calls are compiled ahead, and what is private to numba stands in one folder."""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.util import find_spec

from sources import ROOT, SOURCE_ROOTS, Module, module_of, modules

from uwserver.physics.kernel.compiled import ENTRY_KERNELS

ENTRY = re.compile(r"^@entry\ndef ([a-z]\w*)", re.MULTILINE)


def test_each_kernel_that_python_calls_is_compiled_ahead() -> None:
    """One that is not listed would be compiled where somebody waits for it. Those of our own tree of rays are needed where Embree is not there."""
    listed = {name for names in ENTRY_KERNELS.values() for name in names}
    found: set[str] = set()
    for module in modules("uwserver"):
        stem = module.path.stem
        if module.part == "physics" and (stem != "tree" or not find_spec("embreex")):
            found |= {f"{stem}.{name}" for name in ENTRY.findall(module.text)}
    assert len(found) > 20
    assert found <= listed


PRIVATE = "uwserver.physics.kernel.numba_private"
OF_EVERYBODY = {
    "numba": {"", "carray", "typeof", "types"},
    "numba.core": {"cgutils", "types"},
    "numba.core.codegen": {"get_host_cpu_features"},
    "numba.core.types": {"unliteral"},
    "numba.extending": {"intrinsic"},
}
"""What extensions of numba are written with, by module; all else is its own affair, and changes with its versions."""


def privately_used(each: Iterable[Module]) -> list[str]:
    """Where a module relies on more of numba than everybody may."""
    return [
        module.at(found.line, f"{found.target}.{found.name}")
        for module in each
        if not module.name.startswith(PRIVATE)
        for found in module.imports
        if found.target.partition(".")[0] == "numba" and found.name not in OF_EVERYBODY.get(found.target, set())
    ]


def test_what_is_private_to_numba_stands_in_one_small_folder() -> None:
    assert not privately_used([module for root in SOURCE_ROOTS for module in modules(root)])
    folder = [module for module in modules("uwserver") if module.name.startswith(PRIVATE)]
    assert len(folder) <= 3
    assert sum(len(module.text.splitlines()) for module in folder) <= 400
    (needed,) = re.findall(r'"(numba>[^"]*)"', (ROOT / "pyproject.toml").read_text("utf-8"))
    assert "<" in needed, "which versions fit is known up to one"


def test_a_private_part_of_numba_is_found() -> None:
    text = "import numba\nfrom numba.core import types\nfrom numba.core import compiler\nfrom numba.core.caching import _Cache\n"
    found = privately_used([module_of("uwserver.sensors.mine", text)])
    assert [each.rpartition(": ")[2] for each in found] == ["numba.core.compiler", "numba.core.caching._Cache"]
