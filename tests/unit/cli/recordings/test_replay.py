"""`uwserver replay`: which files of a recording's naming it opens. What it does stands in tests/unit/recording and tests/integration."""

from __future__ import annotations

from pathlib import Path

import pytest

from uwserver.cli.recordings.replay import _found
from uwserver.recording.reading import NotReplayable


def test_a_named_file_is_found_in_the_folders_in_turn(tmp_path: Path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "x.py").touch()
    (tmp_path / "b" / "y.py").touch()
    folders = tmp_path / "a", tmp_path / "b"
    assert _found("x.py", folders) == tmp_path / "a" / "x.py"
    assert _found("y.py", folders) == tmp_path / "b" / "y.py"


@pytest.mark.parametrize("name", ["../out.py", "link.py", "sub/../../out.py", "missing.py", "sub"])
def test_no_name_in_a_log_leads_out_of_its_folder(tmp_path: Path, name: str):
    folder = tmp_path / "in"
    (folder / "sub").mkdir(parents=True)
    (tmp_path / "out.py").touch()
    (folder / "link.py").symlink_to(tmp_path / "out.py")
    with pytest.raises(NotReplayable, match="put it there, or go to its folder"):
        _found(name, (folder,))
    with pytest.raises(NotReplayable):
        _found(str(tmp_path / "out.py"), (folder,))
