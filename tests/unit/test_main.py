"""The way into the command line, before anything is imported."""

from __future__ import annotations

import subprocess
import sys

import pytest

import uwserver.__main__ as entry
from uwserver import cli


def test_nothing_heavy_is_imported_before_a_signal_is_heard() -> None:
    code = "import sys; import uwserver.__main__; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60).stdout
    assert "uwserver.__main__" in loaded
    assert not {"click", "numpy", "numba", "asyncio", "uwserver.cli"} & set(loaded.split())


def test_too_little_memory_is_told_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def starve(**_: object) -> None:
        raise MemoryError("Unable to allocate 2.28 MiB")

    monkeypatch.setattr(cli, "main", starve)
    with pytest.raises(SystemExit) as ended:
        entry.start()
    assert ended.value.code == 1
    told = (
        "uwserver: there is too little memory: Unable to allocate 2.28 MiB; raise the limit (ulimit -v) or load less\n"
    )
    assert capsys.readouterr().err == told
