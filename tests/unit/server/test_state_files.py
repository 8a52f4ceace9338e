"""Files of saved states: whole or not at all, and no way out of the folder."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from uwserver.server.state_files import read_state, write_state


def test_two_at_once_leave_one_of_both_whole(tmp_path: Path) -> None:
    path, contents = tmp_path / "x.uwstate", [bytes([k]) * 300_000 for k in range(4)]
    for _ in range(5):
        threads = [threading.Thread(target=write_state, args=(path, content)) for content in contents]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
        assert path.read_bytes() in contents
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_leaves_nothing_behind(tmp_path: Path) -> None:
    target = tmp_path / "x.uwstate"
    (target / "full").mkdir(parents=True)  # a folder that is not empty cannot be replaced
    with pytest.raises(OSError, match="irectory"):
        write_state(target, b"x")
    assert list(tmp_path.iterdir()) == [target]


def test_a_link_at_the_old_name_of_the_part_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    (tmp_path / "x.uwstate.part").symlink_to(victim)
    write_state(tmp_path / "x.uwstate", b"state")
    assert victim.read_bytes() == b"mine"
    assert read_state(tmp_path / "x.uwstate") == b"state"


def test_only_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    for name in ("pipe", "link", ".", "missing"):
        with pytest.raises(OSError, match=r"."):
            read_state(tmp_path / name)
