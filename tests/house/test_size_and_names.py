"""How large a thing may grow, how it may be called, and that it says what it is."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from sources import Module, every_module, module_of, modules

MOST_STATEMENTS = 300
MOST_FILES = 22
MOST_LINES_OF_A_FUNCTION = 60
MOST_LINES_OF_A_KERNEL = 100
MOST_DEPTH_OF_A_LONG_KERNEL = 3
"""The body, a branch or loop, and what stands in that."""
EMPTY = re.compile(r"(manager|helper|util|utils|handler|handlers|helpers|misc|common)$", re.IGNORECASE)
"""Such a name says that its owner did not know what the thing is; it then collects everything else."""


def test_no_module_has_more_than_300_statements():
    """A longer one does more than one thing. Statements are counted, not lines, so that nobody saves a comment or cuts a table in two."""
    assert {m.name: m.statements for m in every_module() if m.statements > MOST_STATEMENTS} == {}


def full_folders(paths: Iterable[Path]) -> dict[str, int]:
    """Folders with more source files than one reads the names of, by the number of files."""
    files = Counter(str(path.parent) for path in paths if path.name != "__init__.py")
    return {folder: n for folder, n in files.items() if n > MOST_FILES}


def test_no_folder_has_more_than_22_files():
    """A larger one has folders that say what is in them."""
    assert full_folders(module.path for module in every_module()) == {}


def test_a_large_module_and_a_full_folder_are_found():
    assert module_of("uwserver.world.a", '"""A."""\nx = 1\ndef f():\n    """F."""\n    return x\n').statements == 3
    files = [Path("uwserver", "world", f"{k}.py") for k in range(MOST_FILES + 1)]
    assert full_folders(files) == {"uwserver/world": MOST_FILES + 1}
    assert full_folders(files[1:]) == {}


def long_functions(each: Iterable[Module]) -> list[str]:
    """Functions with more lines than one looks through at once. Aim at 50.

    One in compiled code may be longer if it is flat, with no more than a branch in a branch: it writes down a formula, which to cut would hide, and
    each call costs.
    """
    wrong = []
    for module in each:
        for name, line, lines, depth, compiled in module.functions:
            flat = compiled and depth <= MOST_DEPTH_OF_A_LONG_KERNEL
            if lines > (MOST_LINES_OF_A_KERNEL if flat else MOST_LINES_OF_A_FUNCTION):
                wrong.append(module.at(line, f"{name} has {lines} lines"))
    return wrong


def test_a_function_fits_on_a_screen():
    assert long_functions(every_module()) == []


def test_a_long_function_is_found():
    def function(lines: int, depth: int = 1) -> str:
        nested = "".join(f"{'    ' * k}for i in x:\n" for k in range(1, depth))
        return f"def f(x):\n{nested}" + f"{'    ' * depth}x = 1\n" * (lines - depth)

    plain, long, kernel, deep, longest = (
        module_of("uwserver.physics.a", text)
        for text in (
            function(60), function(61), f"@compiled\n{function(100, 3)}", f"@compiled\n{function(61, 4)}", f"@entry\n{function(101)}",
        )
    )  # fmt: skip
    assert long_functions([plain, kernel]) == []
    assert len(long_functions([long, deep, longest])) == 3


def empty_names(each: Iterable[Module]) -> list[str]:
    """Of modules and classes."""
    wrong = []
    for module in each:
        if any(re.search(rf"(^|_){EMPTY.pattern}", part, re.IGNORECASE) for part in module.name.split(".")):
            wrong.append(module.name)
        wrong += [f"{module.name}.{name}" for name in module.classes if EMPTY.search(name)]
    return wrong


def test_no_empty_names():
    assert empty_names(every_module()) == []


def test_an_empty_name_is_found():
    assert empty_names([module_of("uwserver.world.time_utils", "class A:\n    class ThingManager: ...")]) == [
        "uwserver.world.time_utils",
        "uwserver.world.time_utils.ThingManager",
    ]


def undocumented(each: Iterable[Module]) -> list[str]:
    """Public names without a docstring: modules, classes, functions, methods. A method that a contract or a framework names may leave it to that."""
    return [module.at(line, name) for module in each for line, name in module.undocumented]


def test_every_public_name_has_a_docstring():
    """Units, frames and errors are said there."""
    assert undocumented(modules("uwserver")) == []


def test_a_name_without_docstring_is_found():
    text = 'class A:\n    """Of something."""\n    def f(self): ...\n    def _g(self): ...\nclass B(A):\n    """Of it."""\n    def f(self): ...\n'
    assert len(undocumented([module_of("uwserver.world.a", text)])) == 2  # the module, and A.f
