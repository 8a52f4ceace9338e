"""The source as the rules of the house look at it: every module is read once, and nothing of it is imported.

A syntax tree is a hundred times as large as its text, so none is kept: a rule that has to look at expressions parses those modules again that
name what it looks for.
"""

from __future__ import annotations

import ast
import gc
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
SOURCE_ROOTS = {
    "uwserver": ROOT,
    "uwserver_bench": ROOT / "bench",
    "uwserver_adapters": ROOT / "adapters",
    "uwserver_scenarios": ROOT / "scenarios",
    "uwclient": ROOT / "clients" / "python",
}
COMPILED = {"compiled", "entry", "inlined", "separate"}
"""Decorators of what becomes machine code."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


class Import(NamedTuple):
    """A module named in an import, what is taken of it (empty: itself), where, and whether at run time of the importing module itself (neither in
    a function nor for type checkers)."""

    target: str
    name: str
    line: int
    eager: bool


class Length(NamedTuple):
    """A function's lines from `def` to its end, how deep its statements are nested, and whether it becomes machine code."""

    name: str
    line: int
    lines: int
    depth: int
    compiled: bool


class Module(NamedTuple):
    """A source file. `statements` leaves out docstrings."""

    name: str
    path: Path
    text: str
    statements: int
    imports: tuple[Import, ...]
    functions: tuple[Length, ...]
    classes: tuple[str, ...]
    undocumented: tuple[tuple[int, str], ...]

    @property
    def part(self) -> str:
        """Its part of the package, a folder or a file at the top."""
        return self.name.split(".")[1] if "." in self.name else ""

    def nodes(self, *suspect: str) -> Iterator[ast.AST]:
        """All nodes of its syntax tree, if its text holds something suspect, were it only in a comment: regular expressions, each of which is found
        quickly where it begins with a letter that stands for itself."""
        if any(re.search(each, self.text) for each in suspect):
            yield from ast.walk(ast.parse(self.text))

    def at(self, line: int, what: str) -> str:
        """A fault as it is told."""
        return f"{self.path}:{line}: {what}"


@cache
def paths() -> dict[str, Path]:
    """Where each module is, by dotted name."""
    found = {}
    for package, base in SOURCE_ROOTS.items():
        for path in sorted((base / package).rglob("*.py")):
            name = ".".join(path.relative_to(base).with_suffix("").parts).removesuffix(".__init__")
            found[name] = path.relative_to(ROOT)
    return found


@cache
def modules(package: str) -> tuple[Module, ...]:
    """All source files of one of the SOURCE_ROOTS."""
    gc.disable()  # which would look through all that the other tests have made, again and again
    try:
        found = [
            module_of(name, (ROOT / path).read_text(encoding="utf-8"), path)
            for name, path in paths().items()
            if name.split(".")[0] == package
        ]
    finally:
        gc.enable()
    assert found, f"no source of {package}"
    return tuple(found)


def every_module() -> Iterator[Module]:
    """Those of all source roots."""
    for package in SOURCE_ROOTS:
        yield from modules(package)


def module_of(name: str, text: str, path: Path | None = None) -> Module:
    """What a text says as the module of that name."""
    tree = ast.parse(text)
    statements = tuple(_statements(tree.body))
    return Module(
        name,
        path or Path(f"{name}.py"),
        text,
        sum(not _is_docstring(node) for node, _ in statements),
        tuple(
            i
            for node, eager in statements
            if isinstance(node, ast.Import | ast.ImportFrom)
            for i in _imports(node, eager)
        ),
        tuple(_length(node) for node, _ in statements if isinstance(node, Function)),
        tuple(node.name for node, _ in statements if isinstance(node, ast.ClassDef)),
        tuple(_undocumented(tree)),
    )


def _is_docstring(node: ast.stmt) -> bool:
    """Whether a statement is a text that says what something is."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _inner(statement: ast.stmt) -> list[ast.stmt]:
    """The statements that stand directly in a statement."""
    if not hasattr(statement, "body") and not hasattr(statement, "cases"):
        return []
    inner = [child for name in ("body", "orelse", "finalbody") for child in getattr(statement, name, ())]
    return inner + [
        child for name in ("handlers", "cases") for each in getattr(statement, name, ()) for child in each.body
    ]


def _statements(body: Iterable[ast.stmt], eager: bool = True) -> Iterator[tuple[ast.stmt, bool]]:
    """All, also those inside functions, and whether they run when the module is imported."""
    for node in body:
        yield node, eager
        if inner := _inner(node):
            waits = isinstance(node, Function) or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
            yield from _statements(inner, eager and not waits)


def _imports(node: ast.Import | ast.ImportFrom, eager: bool) -> Iterator[Import]:
    if isinstance(node, ast.Import):
        yield from (Import(alias.name, "", node.lineno, eager) for alias in node.names)
        return
    source = "." * node.level + (node.module or "")
    for alias in node.names:
        inner = f"{source}.{alias.name}"
        if inner in paths():
            yield Import(inner, "", node.lineno, eager)
        else:
            yield Import(source, alias.name, node.lineno, eager)


def _length(node: Function) -> Length:
    compiled = any(isinstance(each, ast.Name) and each.id in COMPILED for each in node.decorator_list)
    lines = (node.end_lineno or node.lineno) - node.lineno + 1
    return Length(node.name, node.lineno, lines, _depth(node) if compiled else 0, compiled)


def _depth(node: ast.stmt) -> int:
    """How many statements stand around the innermost one."""
    return max((1 + _depth(child) for child in _inner(node)), default=0)


def _undocumented(tree: ast.Module) -> Iterator[tuple[int, str]]:
    if tree.body and not ast.get_docstring(tree):
        yield 1, "the module"
    for node in _public(tree):
        if not ast.get_docstring(node):
            yield node.lineno, node.name


def _public(tree: ast.Module) -> Iterator[Function | ast.ClassDef]:
    for node in tree.body:
        if isinstance(node, Function | ast.ClassDef) and not node.name.startswith("_"):
            yield node
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for member in node.body:
                if isinstance(member, Function) and not member.name.startswith("_"):
                    setter = any(isinstance(d, ast.Attribute) and d.attr == "setter" for d in member.decorator_list)
                    if not setter and not _inherited(node, member.name):
                        yield member


def _inherited(owner: ast.ClassDef, name: str) -> bool:
    """Whether a class fills in what another declares and documents (a subclass, `build` of a table, or an adapter's subscriber)."""
    bases = [ast.unparse(base) for base in owner.bases]
    if name == "build" and any(base.endswith("Table") for base in bases):
        return True
    return bool(bases) and not any(base.endswith(("Protocol", "Table", "Struct")) for base in bases)
