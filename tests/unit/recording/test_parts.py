"""New files for recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from uwserver.recording.parts import new_file


def test_a_file_that_is_there_is_not_overwritten(tmp_path: Path):
    (tmp_path / "a").write_text("dive")
    with pytest.raises(FileExistsError, match="give --record another name"):
        new_file(tmp_path / "a")
    assert (tmp_path / "a").read_text() == "dive"
    with pytest.raises(OSError, match="a place that can be written"):
        new_file(tmp_path / "no" / "a")
