"""The kernels of physics run once, on each of their paths."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from uwserver.physics import warm
from uwserver.physics.kernel.compiled import ENTRY_KERNELS


def test_each_path_is_run_and_told() -> None:
    lines: list[str] = []
    warm.check(lines.append)
    assert len(lines) == 7


def test_what_is_not_finite_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    body = warm._body(1.0)
    monkeypatch.setattr(warm, "_body", lambda drag: replace(body, weight=float("nan")))
    with pytest.raises(RuntimeError, match="not finite"):
        warm.check()


def test_each_stage_has_what_compiles_it() -> None:
    assert warm.COMPILE.keys() == ENTRY_KERNELS.keys()


def test_each_kernel_that_python_calls_is_compiled_ahead() -> None:
    """One that is not listed would be compiled where somebody waits for it."""
    listed = {name for names in ENTRY_KERNELS.values() for name in names}
    entry, found = re.compile(r"^@entry\ndef ([a-z]\w*)", re.MULTILINE), set()
    for module in Path(warm.__file__).parent.rglob("*.py"):
        if module.stem != "tree" or not find_spec("embreex"):
            found |= {f"{module.stem}.{name}" for name in entry.findall(module.read_text(encoding="utf-8"))}
    assert len(found) > 20
    assert found <= listed
