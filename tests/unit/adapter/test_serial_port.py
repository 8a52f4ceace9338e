"""A serial line that comes and goes: what it says is handed on, and its troubles are told."""

from __future__ import annotations

import asyncio
import os
import pty
from pathlib import Path

import pytest

from uwserver.adapter import SerialPort, serial_port
from uwserver.testing import FakeContext


def make(path: str, context: FakeContext) -> tuple[SerialPort, list[object]]:
    """A port, and what it called."""
    seen: list[object] = []
    opened, closed = (lambda: seen.append("opened")), (lambda: seen.append("closed"))
    return SerialPort(path, context, opened=opened, received=seen.append, closed=closed), seen


def test_bytes_go_both_ways_until_the_other_end_goes():
    async def run() -> None:
        ours, theirs = pty.openpty()
        context = FakeContext()
        port, seen = make(os.ttyname(theirs), context)
        port.attend()
        assert port.write(b"out\n")
        assert os.read(ours, 16) == b"out\n"
        os.write(ours, b"in\n")
        while len(seen) < 2:
            await asyncio.sleep(0)
        os.close(theirs)
        os.close(ours)
        while port.is_open:
            await asyncio.sleep(0)
        assert seen == ["opened", b"in\n", "closed"]
        assert "it is tried again" in context.stats.last_error
        assert not port.write(b"nobody")

    asyncio.run(asyncio.wait_for(run(), 120.0))


def test_a_device_that_is_not_there_is_logged_once(tmp_path: Path, caplog):
    context = FakeContext()
    port, seen = make(str(tmp_path / "ttyS9"), context)
    port.attend()
    port.attend()
    assert "ttyS9" in context.stats.last_error
    assert len(caplog.records) == 1
    assert not seen


def test_a_system_without_terminals_says_so_once(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture):
    """As on Windows, where the module cannot even be imported."""
    monkeypatch.setattr(serial_port, "termios", None)
    context = FakeContext()
    port, seen = make("COM3", context)
    port.attend()
    port.attend()
    assert "serial line COM3: this system has no terminals as POSIX has: use UDP or TCP" in context.stats.last_error
    assert len(caplog.records) == 1
    assert not port.is_open
    assert not seen
