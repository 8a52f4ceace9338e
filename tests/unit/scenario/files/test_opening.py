"""Files are opened only where reading them ends; see tests/unit/scenario/load/test_hostile_files.py for what a user is told."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from uwserver.scenario.files import opening
from uwserver.scenario.files.opening import is_plain, opened, read_whole


def test_a_file_is_read_whole_up_to_its_limit(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    assert read_whole(tmp_path / "a", 5) == b"12345"
    with pytest.raises(OSError, match="it has 5 bytes; at most 4 are allowed"):
        read_whole(tmp_path / "a", 4)


def test_a_file_that_grows_is_not_half_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    look = os.fstat

    def look_and_grow(descriptor: int) -> os.stat_result:
        seen = look(descriptor)
        with (tmp_path / "a").open("ab") as file:
            file.write(b"6")
        return seen

    monkeypatch.setattr(opening.os, "fstat", look_and_grow)
    with pytest.raises(OSError, match="it grew while it was read"):
        read_whole(tmp_path / "a", 100)


def test_no_descriptor_is_left_of_what_is_no_file(tmp_path: Path) -> None:
    before = len(list(Path("/dev/fd").iterdir()))
    for _ in range(20):
        with pytest.raises(OSError, match="not a regular file"), opened(tmp_path):
            pass
    assert len(list(Path("/dev/fd").iterdir())) == before


@pytest.mark.parametrize("name", ["a\0b", "\ud800", "a" * 5000])
def test_a_name_that_no_file_can_have(name: str, tmp_path: Path) -> None:
    assert not is_plain(tmp_path / name)
    with pytest.raises(OSError, match=r"a file cannot have this name|File name too long"), opened(tmp_path / name):
        pass
