"""A log of an adapter: flushed by itself, and ended by a full disk without harm to who writes."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path

import pytest

from uwserver.adapter import LogFile, log_file
from uwserver.testing.fake_context import FakeContext


def test_what_was_written_is_on_the_disk_before_it_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_file, "FLUSH_S", 0.0)

    async def scene() -> None:
        log = LogFile(str(tmp_path / "x.log"), FakeContext())
        log.write(b"one")
        await asyncio.sleep(0.02)
        assert (tmp_path / "x.log").read_bytes() == b"one"
        log.close()
        log.write(b"two")
        assert (tmp_path / "x.log").read_bytes() == b"one"

    asyncio.run(scene())


def test_earlier_logs_are_kept_under_a_number(tmp_path: Path) -> None:
    async def scene() -> None:
        for text in (b"first", b"second", b"third"):
            log = LogFile(str(tmp_path / "dive.tlog"), FakeContext())
            log.write(text)
            log.close()

    asyncio.run(scene())
    names = ("dive_1.tlog", "dive_2.tlog", "dive.tlog")
    assert [(tmp_path / name).read_bytes() for name in names] == [b"first", b"second", b"third"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, as Linux has it")
def test_a_full_disk_ends_the_log_and_nothing_else(caplog: pytest.LogCaptureFixture) -> None:
    async def scene() -> None:
        context = FakeContext()
        log = LogFile("/dev/full", context)
        with caplog.at_level(logging.WARNING):
            for _ in range(100):
                log.write(bytes(4096))
        assert context.stats.errors == 1
        assert "the log /dev/full ends" in context.stats.last_error
        log.close()

    asyncio.run(scene())
