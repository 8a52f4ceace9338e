"""The kernels of physics run once, on each of their paths."""

from __future__ import annotations

from dataclasses import replace

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
