"""uwclient runs on Python 3.9: syntax of 3.9, no union evaluated at run time, nothing but the standard library."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator

import pytest
from sources import modules


def evaluated(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that run, so not those of annotations (kept as text by the __future__ import)."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child
                yield from evaluated(child)


def faults(source: str) -> list[str]:
    """Return what Python 3.9 would not take in a module."""
    try:
        tree = ast.parse(source, feature_version=(3, 9))
    except SyntaxError as error:
        return [f"syntax: {error}"]
    found = [] if "from __future__ import annotations" in source else ["no __future__ annotations"]
    for node in evaluated(tree):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
            found.append(f"line {node.lineno}: union at run time")
        if isinstance(node, ast.Call):
            found += [f"line {node.lineno}: {k.arg}=" for k in node.keywords if k.arg in ("slots", "kw_only", "strict")]
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        for name in names:
            root = name.split(".")[0]
            # numpy stands under TYPE_CHECKING only; tests/unit/client/test_imports.py proves that.
            if root not in {"uwclient", "numpy", *sys.stdlib_module_names} or root == "tomllib":
                found.append(f"line {node.lineno}: imports {name}")
    return found


def test_modules_are_for_python_3_9() -> None:
    assert {module.name: found for module in modules("uwclient") if (found := faults(module.text))} == {}


@pytest.mark.parametrize(
    "source",
    [
        "from __future__ import annotations\nmatch x:\n    case 1: pass",
        "from __future__ import annotations\nX = int | str",
        "from __future__ import annotations\nx = cast(int | None, y)",
        "from __future__ import annotations\nx = zip(a, b, strict=True)",
        "from __future__ import annotations\nimport typing_extensions",
        "def f(x: int | None): ...",
        "from __future__ import annotations\nwith (open(a) as x, open(b) as y,): pass\ntry: pass\nexcept* E: pass",
    ],
)
def test_the_check_finds_what_it_is_for(source: str) -> None:
    assert faults(source)
