"""The first bytes of a file tell which reader it wants."""

import sys

import pytest

from uwserver.logfiles import LogError, open_log
from uwserver.logfiles.foreign import foreign


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(LogError, match=r"gone\.mcap: it cannot be opened as a log: No such file"):
        open_log(tmp_path / "gone.mcap")


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"PK\x03\x04" + b"\xff" * 500])
def test_what_is_no_log_is_told(tmp_path, content):
    file = tmp_path / "some.zip"
    file.write_bytes(content)
    with pytest.raises(LogError, match=r"some\.zip"):
        open_log(file)


@pytest.mark.parametrize(
    ("begin", "name", "module", "package"),
    [
        (b"#ROSBAG V2.0\n", "a.bag", "rosbags.rosbag1", "rosbags"),
        (b"ULog\x01\x12\x35", "a.ulg", "pyulog", "pyulog"),
        (b"PAR1", "a.parquet", "pyarrow", "pyarrow"),
    ],
)
def test_a_missing_package_is_told_with_what_brings_it(tmp_path, monkeypatch, begin, name, module, package):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(begin)
    with pytest.raises(LogError, match=rf"needs the package {package}: pip install 'uwserver\[logs\]'"):
        open_log(tmp_path / name)


def test_errors_of_foreign_parsers_are_one_kind(tmp_path):
    class Strange(Exception):
        pass

    for error, told in (
        (Strange("a\nb"), "a b"),
        (MemoryError(), "damaged"),
        (ImportError("x", name="google.protobuf"), "protobuf"),
    ):
        with pytest.raises(LogError, match=told), foreign(tmp_path, "it"):
            raise error
    with pytest.raises(KeyboardInterrupt), foreign(tmp_path, "it"):
        raise KeyboardInterrupt
