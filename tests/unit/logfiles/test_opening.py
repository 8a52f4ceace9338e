"""The first bytes of a file tell which reader it wants."""

import pytest

from uwserver.logfiles import LogError, open_log


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(LogError, match=r"gone\.mcap: it cannot be opened as a log: No such file"):
        open_log(tmp_path / "gone.mcap")


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"PK\x03\x04" + b"\xff" * 500])
def test_what_is_no_log_is_told(tmp_path, content):
    file = tmp_path / "some.zip"
    file.write_bytes(content)
    with pytest.raises(LogError, match=r"some\.zip"):
        open_log(file)
